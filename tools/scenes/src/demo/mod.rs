//! The demo: typical uses of reflections in one image.

mod glowing;

use crate::{animation::Motion, prelude::*};

const COLUMNS: usize = 7;

fn sun() -> Vec3 {
    sun_direction(-108.0, 31.0)
}

/// An evening sky.
pub fn environment(world: &mut World) -> Environment {
    Environment::under(world, Sky::Evening { sun: sun() }, 560.0, 9.7)
}

pub fn spawn(scene: &mut SceneBuilder, options: &SceneOptions) {
    let size = options.texture_size;
    // Both directions of a surface get finer, so each by the square root.
    let fine = options.detail.sqrt();
    room(scene, size, fine);
    screens(scene, size, fine);
    gallery_of_spheres(scene, size, fine);
    floor_objects(scene, size, fine);
    plants(scene, size, fine);
    glowing::neon(scene, fine);
    glowing::gyroscope(scene, fine);
    glowing::lights(scene);
}

const BRASS: Color = Color::srgb(0.93, 0.76, 0.45);
const CHROME: Color = Color::srgb(0.95, 0.95, 0.96);
const COPPER: Color = Color::srgb(0.96, 0.66, 0.52);
const GOLD: Color = Color::srgb(1.0, 0.82, 0.42);

/// Floor and walls.
fn room(scene: &mut SceneBuilder, size: u32, fine: f32) {
    let tiles = scene.textures(2 * size, patterns::polished_tiles).material();
    let tiles = scene.material(StandardMaterial {
        reflectance: 0.6,
        ..tiles
    });
    let floor = scene.shape(|g| {
        for (x, z) in (-3..3).flat_map(|x| (-3..3).map(move |z| (x as f32 * 4.0, z as f32 * 4.0))) {
            g.quad(level_corners(vec2(x, z), vec2(x + 4.0, z + 4.0), 0.0), Vec2::ONE);
        }
    });
    scene.place(&floor, &tiles, Transform::from_xyz(0.15, 0.0, 0.4));

    let brick = scene.textured(size, patterns::brick);
    let wall = scene.shape(|g| g.cuboid(vec3(0.0, 1.8, 0.0), vec3(8.4, 3.6, 0.35), 0.5));
    scene.place(&wall, &brick, Transform::from_xyz(-1.4, 0.0, -4.2));

    let plaster = scene.textured(size, patterns::plaster);
    let side = scene.shape(|g| g.cuboid(vec3(0.0, 1.8, 0.0), vec3(0.35, 3.6, 7.4), 0.4));
    scene.place(&side, &plaster, Transform::from_xyz(5.3, 0.0, -0.6));

    let stone = scene.textured(size, patterns::limestone);
    let long = scene.shape(|g| g.rounded_box(Vec3::ZERO, vec3(8.6, 0.16, 0.55), 0.04, 3, 0.6));
    let short = scene.shape(|g| g.rounded_box(Vec3::ZERO, vec3(0.55, 0.16, 7.6), 0.04, 3, 0.6));
    let skirting = scene.shape(|g| g.rounded_box(Vec3::ZERO, vec3(8.4, 0.2, 0.06), 0.02, 2, 0.6));
    scene.place(&long, &stone, Transform::from_xyz(-1.4, 3.66, -4.2));
    scene.place(&short, &stone, Transform::from_xyz(5.3, 3.66, -0.6));
    scene.place(&skirting, &stone, Transform::from_xyz(-1.4, 0.1, -4.0));
    let column = scene.shape(|g| props::column(g, 3.6, 0.24, segments(32, fine)));
    for x in [2.95, 4.85] {
        scene.place(&column, &stone, Transform::from_xyz(x, 0.0, -4.2));
    }
}

/// The carved screens on the sun's side, and the curtain in the opening of the back wall.
fn screens(scene: &mut SceneBuilder, size: u32, fine: f32) {
    let lattice = scene.textures(size, patterns::lattice).material();
    let lattice = scene.material(StandardMaterial {
        alpha_mode: AlphaMode::Mask(0.5),
        ..both_sides(dielectric(lattice))
    });
    let wood = scene.material(gloss(Color::srgb(0.36, 0.21, 0.11), 0.45));
    let panel = scene.shape(|g| {
        let corners = upright_corners(vec2(-1.1, 0.0), vec2(1.1, 2.9), 0.0);
        g.quad(corners, vec2(1.0, 1.318));
    });
    let frame = scene.shape(|g| {
        for x in [-1.15, 1.15] {
            g.rounded_box(vec3(x, 1.5, 0.0), vec3(0.1, 3.0, 0.1), 0.015, 2, 1.0);
        }
        for y in [0.05, 2.95] {
            g.rounded_box(vec3(0.0, y, 0.0), vec3(2.3, 0.1, 0.09), 0.015, 2, 1.0);
        }
    });
    for (x, z, angle) in [
        (-5.0, -2.6, 82.0),
        (-4.75, 0.0, 70.0),
        (-4.75, 2.7, 84.0),
        (-4.9, 5.2, 92.0),
    ] {
        let transform = Transform::from_xyz(x, 0.02, z).with_rotation(turned(angle));
        scene.place(&panel, &lattice, transform);
        scene.place(&frame, &wood, transform);
    }

    let weave = scene.textures(size, patterns::cloth).material();
    let red = scene.material(both_sides(dielectric(dyed(&weave, Color::srgb(0.80, 0.09, 0.10)))));
    let curtain = scene.shape(|g| props::curtain(g, 1.35, 3.0, 6.0, segments(72, fine), segments(24, fine)));
    scene.place(&curtain, &red, Transform::from_xyz(3.9, 0.25, -4.15));
    let brass = scene.material(metal(BRASS, 0.25));
    let rod = scene.shape(|g| {
        let ends = [vec3(2.9, 3.28, -4.15), vec3(4.9, 3.28, -4.15)];
        g.tube(&ends, 0.025, segments(16, fine));
    });
    scene.place(&rod, &brass, Transform::IDENTITY);
}

/// Three steps with rows of spheres: metal, coloured dielectric, gold; roughness grows to the right.
fn gallery_of_spheres(scene: &mut SceneBuilder, size: u32, fine: f32) {
    let stone = scene.textures(size, patterns::plaster).material();
    let step_stone = scene.material(StandardMaterial {
        base_color: Color::srgb(0.30, 0.32, 0.36),
        perceptual_roughness: 0.45,
        ..stone
    });
    let trim = scene.material(metal(BRASS, 0.22));
    let sphere = scene.shape(|g| g.sphere(Vec3::ZERO, 0.38, segments(72, fine), vec2(2.0, 1.0)));
    for (row, (height, z)) in [(0.22, 0.35), (0.72, -0.75), (1.22, -1.85)].into_iter().enumerate() {
        let step = scene.shape(|g| g.rounded_box(vec3(0.0, height * 0.5, 0.0), vec3(6.5, height, 1.1), 0.03, 3, 0.5));
        let edge =
            scene.shape(|g| g.rounded_box(vec3(0.0, height - 0.075, 0.552), vec3(6.44, 0.025, 0.02), 0.008, 2, 1.0));
        scene.place(&step, &step_stone, Transform::from_xyz(-0.1, 0.0, z));
        scene.place(&edge, &trim, Transform::from_xyz(-0.1, 0.0, z));
        for column in 0..COLUMNS {
            let fraction = column as f32 / (COLUMNS - 1) as f32;
            let material = match row {
                0 => metal(CHROME, fraction),
                1 => gloss(Color::hsl(8.0 + 290.0 * fraction, 0.82, 0.42), fraction),
                _ => metal(if column % 2 == 0 { GOLD } else { COPPER }, fraction),
            };
            let material = scene.material(material);
            let at = Transform::from_xyz(-0.1 + (fraction - 0.5) * 5.4, height + 0.38, z + 0.02);
            scene.place(&sphere, &material, at);
        }
    }
}

/// Boxes, a mirror and a big ball on the floor, and a ball that rolls through the air.
fn floor_objects(scene: &mut SceneBuilder, size: u32, fine: f32) {
    let block = scene.shape(|g| g.rounded_box(vec3(0.0, 0.5, 0.0), Vec3::ONE, 0.05, 4, 1.0));
    let blue = gloss(Color::srgb(0.03, 0.22, 0.50), 0.08);
    let amber = gloss(Color::srgb(0.92, 0.50, 0.06), 0.35);
    for (material, position, edge, angle) in [
        (metal(CHROME, 0.02), vec3(-3.2, 0.0, 1.9), 0.78, 28.0),
        (blue, vec3(-2.6, 0.0, 3.0), 0.42, -18.0),
        (metal(COPPER, 0.32), vec3(-3.12, 0.78, 1.88), 0.36, 52.0),
        (amber, vec3(1.7, 0.0, 3.0), 0.40, 35.0),
    ] {
        let material = scene.material(material);
        let at = Transform::from_translation(position).with_rotation(turned(angle));
        scene.place(&block, &material, at.with_scale(Vec3::splat(edge)));
    }

    let slab = scene.shape(|g| g.rounded_box(vec3(0.0, 1.2, 0.0), vec3(1.3, 2.3, 0.05), 0.02, 3, 1.0));
    let surround = scene.shape(|g| {
        for x in [-0.69, 0.69] {
            g.rounded_box(vec3(x, 1.2, 0.0), vec3(0.1, 2.48, 0.1), 0.02, 3, 1.0);
        }
        for y in [0.03, 2.38] {
            g.rounded_box(vec3(0.0, y, 0.0), vec3(1.46, 0.1, 0.1), 0.02, 3, 1.0);
        }
    });
    let mirror = scene.material(metal(CHROME, 0.0));
    let worn = scene.textures(size / 2, patterns::worn_metal).material();
    let bronze = scene.material(dyed(&worn, Color::srgb(0.80, 0.58, 0.36)));
    let stand = Transform::from_xyz(4.35, 0.02, -0.7).with_rotation(turned(-52.0));
    scene.place(&slab, &mirror, stand);
    scene.place(&surround, &bronze, stand);

    let ball = scene.shape(|g| g.sphere(Vec3::ZERO, 1.0, segments(96, fine), vec2(4.0, 2.0)));
    let vermilion = scene.material(gloss(Color::srgb(0.72, 0.05, 0.03), 0.06));
    let at = Transform::from_xyz(3.85, 0.55, 1.0).with_scale(Vec3::splat(0.55));
    scene.place(&ball, &vermilion, at);
    let moving = scene.place(&ball, &mirror, Transform::from_scale(Vec3::splat(0.26)));
    scene.world.entity_mut(moving).insert(Motion::Orbit {
        center: vec3(-0.35, 0.5, 2.75),
        extent: vec3(1.45, 0.12, 0.55),
        rate: 0.12,
        phase: 0.06,
    });
}

/// Two plants in pots.
fn plants(scene: &mut SceneBuilder, size: u32, fine: f32) {
    let clay = scene.textures(size / 2, patterns::limestone).material();
    let clay = scene.material(dielectric(dyed(&clay, Color::srgb(0.75, 0.42, 0.28))));
    let leaves = scene.textures(size / 2, patterns::leaf).material();
    let leaves = scene.material(props::leaf_material(leaves));
    let pot = scene.shape(|g| props::pot(g, 0.5, 0.3, segments(40, fine)));
    let plant = scene.shape(|g| props::plant(g, 46, 1.0, 6, 3));
    for (position, scale, angle) in [
        (vec3(-3.75, 0.0, -2.9), 1.35, 0.0),
        (vec3(4.62, 0.0, 2.15), 0.95, 130.0),
    ] {
        let place = |at: Vec3| Transform::from_translation(at).with_rotation(turned(angle));
        let at = |at: Vec3| place(at).with_scale(Vec3::splat(scale));
        scene.place(&pot, &clay, at(position));
        scene.place(&plant, &leaves, at(position + Vec3::Y * 0.46 * scale));
    }
}

/// Down to the polished floor before the spheres, across, and back up.
pub const PATH: CameraPath = CameraPath {
    points: &[
        (vec3(-0.9, 1.8, 8.5), vec3(0.15, 1.22, 0.0)),
        (vec3(-2.3, 1.5, 7.3), vec3(0.3, 1.1, 0.0)),
        (vec3(-1.2, 1.1, 6.0), vec3(0.4, 1.0, -0.3)),
        (vec3(1.3, 1.3, 5.8), vec3(-0.3, 1.0, -0.3)),
        (vec3(2.1, 2.0, 7.2), vec3(-0.2, 1.1, 0.0)),
        (vec3(0.7, 2.0, 8.4), vec3(0.0, 1.2, 0.0)),
        (vec3(-0.9, 1.8, 8.5), vec3(0.15, 1.22, 0.0)),
    ],
    seconds: 8.0,
    vertical_degrees: 38.0,
    far: 500.0,
};
