//! Shapes with normals that are hard on reflections: normals that lean far from their triangles, and even away from the viewer. Three
//! bays, of dielectrics, metals and clearcoats, contain each shape once, and each roughness once. Only the shapes reflect, so that any
//! surplus or loss of reflected light is theirs.

use crate::prelude::*;
use std::f32::consts::{PI, TAU};

/// Perceptual roughness of the shapes of a bay.
const ROUGHNESS: [f32; 5] = [0.1, 0.25, 0.45, 0.65, 1.0];

/// Distance from bay to bay.
const BAY: f32 = 44.0;

/// Height of the shapes other than the box, and their distance from each other.
const HEIGHT: f32 = 8.0;
const SPACING: f32 = 11.0;

/// The camera passes in front of the bays. From a quarter and from three quarters of the way it sees all of them.
pub const PATH: CameraPath = CameraPath {
    points: &[
        (vec3(-66.0, 24.0, 40.0), vec3(-46.0, 3.0, -8.0)),
        (vec3(-39.0, 27.0, 48.0), vec3(-33.0, 2.0, -8.0)),
        (vec3(0.0, 28.0, 50.0), vec3(0.0, 2.0, -8.0)),
        (vec3(39.0, 27.0, 48.0), vec3(33.0, 2.0, -8.0)),
        (vec3(66.0, 24.0, 40.0), vec3(46.0, 3.0, -8.0)),
    ],
    seconds: 24.0,
    vertical_degrees: 45.0,
    far: 1000.0,
};

/// A hazy day. Its sun is only a part of the sky, and not a directional light.
pub fn environment(world: &mut World) -> Environment {
    let sun = sun_direction(-40.0, 28.0);
    Environment::under(world, Sky::Day { sun }, 1000.0, 9.7)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    surroundings(scene);
    let bumps = scene.textures(options.texture_size, bumps).normal;
    // The box is the largest shape, with its own space behind the others.
    let shapes = [
        ("box", scene.shape(rounded_box), vec3(0.0, 7.5, -26.0), 0.0),
        ("sphere", scene.shape(low_poly_sphere), front(0), 0.0),
        ("cylinder", scene.shape(smoothed_cylinder), front(1), 0.0),
        ("wall", scene.shape(panel), front(2), 25.0),
        ("leaning cube", scene.shape(leaning_cube), front(3), 35.0),
    ];
    const WALL: usize = 3;
    let finishes: [(&str, fn(f32) -> StandardMaterial); 3] = [
        ("dielectric", dielectric),
        ("metal", metallic),
        ("clearcoat", clearcoat),
    ];
    for (bay, (finish, make)) in finishes.into_iter().enumerate() {
        for (index, (shape, mesh, place, degrees)) in shapes.iter().enumerate() {
            // Another roughness for each shape in each bay; the dielectric box has 0.65.
            let roughness = ROUGHNESS[(index + 3 + 2 * bay) % ROUGHNESS.len()];
            let mut material = make(roughness);
            if index == WALL {
                material.normal_map_texture = Some(bumps.clone());
            }
            let offset = vec3(BAY * (bay as f32 - 1.0), 0.0, 0.0);
            let material = scene.material(material);
            let transform = Transform::from_translation(*place + offset).with_rotation(turned(*degrees));
            let entity = scene.place(mesh, &material, transform);
            let name = Name::new(format!("{shape}, {finish}, {roughness}"));
            scene.world.entity_mut(entity).insert(name);
        }
    }
}

/// Positions of the shapes in front of the box, within a bay.
fn front(index: usize) -> Vec3 {
    vec3(SPACING * (index as f32 - 1.5), 0.5 * HEIGHT, 8.0)
}

/// Plain ground, and lamps that shapes of low roughness reflect.
fn surroundings(scene: &mut SceneBuilder) {
    let ground = scene.shape(|g| g.quad(level_corners(Vec2::splat(-300.0), Vec2::splat(300.0), 0.0), Vec2::ONE));
    let earth = scene.material(unlit(Color::linear_rgb(0.12, 0.1, 0.08)));
    scene.place(&ground, &earth, Transform::IDENTITY);
    let lamp = scene.shape(|g| g.cuboid(Vec3::ZERO, Vec3::splat(2.5), 1.0));
    let colors = [(2.0, 0.3, 0.1), (0.1, 0.9, 2.0), (0.3, 2.0, 0.2)]
        .map(|(red, green, blue)| scene.material(unlit(Color::linear_rgb(red, green, blue))));
    for (index, x) in (-6..=6).enumerate() {
        let place = vec3(SPACING * x as f32, 1.25, 19.0);
        scene.place(&lamp, &colors[index % colors.len()], Transform::from_translation(place));
    }
}

fn dielectric(roughness: f32) -> StandardMaterial {
    gloss(Color::linear_rgb(0.02, 0.02, 0.025), roughness)
}

/// Dark, so that metals do not outshine the other shapes in sums of light.
fn metallic(roughness: f32) -> StandardMaterial {
    metal(Color::linear_rgb(0.25, 0.2, 0.14), roughness)
}

/// The coat is smoother than the surface below it.
fn clearcoat(roughness: f32) -> StandardMaterial {
    StandardMaterial {
        clearcoat: 1.0,
        clearcoat_perceptual_roughness: 0.1,
        ..gloss(Color::linear_rgb(0.08, 0.01, 0.01), roughness)
    }
}

/// The six faces of a box, each of `quads` by `quads` quads. `normal` takes a point, relative to the centre, and the face's own normal.
fn boxed(g: &mut Geometry, size: Vec3, quads: u32, normal: impl Fn(Vec3, Vec3) -> Vec3) {
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        g.shaded_surface(quads, quads, |u, v| {
            let (mut position, mut face) = (Vec3::ZERO, Vec3::ZERO);
            position[axis] = 0.5 * sign;
            position[(axis + 1) % 3] = sign * (u - 0.5);
            position[(axis + 2) % 3] = v - 0.5;
            face[axis] = sign;
            let position = position * size;
            (position, normal(position, face))
        });
    }
}

/// A large box with the normals of a sphere.
fn rounded_box(g: &mut Geometry) {
    boxed(g, vec3(36.0, 15.0, 18.0), 8, |position, _| position);
}

/// Few triangles with the normals of the sphere around them.
fn low_poly_sphere(g: &mut Geometry) {
    g.shaded_surface(8, 5, |u, v| {
        let ((sin, cos), height) = (sin_cos(TAU * u), sin_cos(PI * (1.0 - v)));
        let normal = vec3(height.0 * sin, height.1, height.0 * cos);
        (0.5 * HEIGHT * normal, normal)
    });
}

/// A cylinder with a side and caps that share the normals of the rim, as if its edges were round.
fn smoothed_cylinder(g: &mut Geometry) {
    const SIDES: u32 = 12;
    let (radius, top) = (0.4 * HEIGHT, 0.5 * HEIGHT);
    let rim = |u: f32, sign: f32| {
        let (sin, cos) = sin_cos(TAU * u);
        (vec3(radius * sin, sign * top, radius * cos), vec3(sin, sign, cos))
    };
    let center = |sign: f32| (vec3(0.0, sign * top, 0.0), vec3(0.0, sign, 0.0));
    g.shaded_surface(SIDES, 1, |u, v| rim(u, 2.0 * v - 1.0));
    g.shaded_surface(SIDES, 1, |u, v| if v < 0.5 { rim(u, 1.0) } else { center(1.0) });
    g.shaded_surface(SIDES, 1, |u, v| if v < 0.5 { center(-1.0) } else { rim(u, -1.0) });
}

/// The wall of the normal map.
fn panel(g: &mut Geometry) {
    boxed(g, vec3(HEIGHT, HEIGHT, 1.5), 1, |_, face| face);
}

/// A cube with normals that lean up to 75 degrees to all sides: in each view some face away.
fn leaning_cube(g: &mut Geometry) {
    boxed(g, Vec3::splat(0.8 * HEIGHT), 8, |position, face| {
        let (sin, cos) = sin_cos(0.9 * (position.x + 1.3 * position.y + 1.7 * position.z));
        let (right, up) = (face.zxy(), face.yzx());
        let lean = 75f32.to_radians() * ops::sin(1.1 * (position.x - position.y + position.z)).abs();
        let (lean_sin, lean_cos) = sin_cos(lean);
        face * lean_cos + (right * cos + up * sin) * lean_sin
    });
}

/// Bumps that lean up to 60 degrees.
fn bumps(place: Vec2) -> Texel {
    const WAVES: f32 = 4.0;
    const SLOPE: f32 = 1.2;
    let wave = |x: f32| ops::sin(TAU * WAVES * x);
    Texel {
        height: SLOPE * (wave(place.x) + wave(place.y)) / (TAU * WAVES),
        ..Default::default()
    }
}

fn sin_cos(angle: f32) -> (f32, f32) {
    (ops::sin(angle), ops::cos(angle))
}
