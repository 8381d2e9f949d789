//! Custom materials in reflections: their look for rays, and stand-ins for single objects.
//!
//! Three objects turn in front of a mirror. The first has an extended material, which rays see as its base. The second has the app's own
//! material, which `ReflectedMaterial` describes for rays, and a `ReflectedSurfaceShader` draws its bands in the mirror, too. The third
//! is a dense mesh that reflections replace by a coarse one. The Space key also shows the coarse mesh outside of the mirror, permanently.

use bevy::{
    asset::uuid_handle,
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::AsBindGroup,
    shader::{Shader, ShaderRef},
};
use bevy_glint::{ReflectedSurfaceShader, prelude::*};

fn main() {
    App::new().add_plugins((DefaultPlugins, plugin)).run();
}

/// Everything that the app adds to Bevy.
pub fn plugin(app: &mut App) {
    app.add_plugins((
        RayTracedReflectionsPlugin::default(),
        MaterialPlugin::<Enamel>::default(),
        MaterialPlugin::<Lava>::default(),
        // These lines make both visible to rays. Shaders see them as types 1 and 2.
        ReflectedMaterialPlugin::<Enamel>::default(),
        ReflectedMaterialPlugin::<Lava>::default(),
    ))
    .insert_resource(ReflectedSurfaceShader {
        shader: REFLECTED_SHADER,
        animated: true,
    })
    .add_systems(Startup, (add_shaders, setup, show_keys))
    .add_systems(Update, (turn, glow, swap_meshes));
}

/// A `StandardMaterial` with an extension.
type Enamel = ExtendedMaterial<StandardMaterial, Wear>;

/// A real extension has fields and a shader.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
struct Wear {}

impl MaterialExtension for Wear {}

/// A material with its own shader. It is drawn forward and adds no light of the environment, so it doesn't show reflections itself.
#[derive(Asset, AsBindGroup, Reflect, Clone)]
struct Lava {
    #[uniform(0)]
    heat: LinearRgba,
}

const LAVA_SHADER: Handle<Shader> = uuid_handle!("5a2b3c1e-7c0d-4b8e-9a61-0f7d2f0c6b11");
const REFLECTED_SHADER: Handle<Shader> = uuid_handle!("5a2b3c1e-7c0d-4b8e-9a61-0f7d2f0c6b12");

/// Dark bands that rise. Appended to both sources: imports must come first.
const BANDS: &str = "
    fn bands(uv: vec2<f32>, seconds: f32) -> f32 {
        return 0.15 + 0.85 * smoothstep(0.3, 0.5, abs(2.0 * fract(4.0 * uv.y + 0.1 * sin(9.0 * uv.x) + 0.2 * seconds) - 1.0));
    }
";
const LAVA: &str = "
    import bevy_pbr::render::forward_io::VertexOutput;
    import bevy_pbr::render::mesh_view_bindings::globals;
    @group(constants::MATERIAL_BIND_GROUP) @binding(0) var<uniform> heat: vec4<f32>;
    @fragment
    fn fragment(in: VertexOutput) -> @location(0) vec4<f32> {
        return vec4(heat.rgb * bands(in.uv, globals.time), 1.0);
    }
";
const REFLECTED: &str = "
    import bevy_glint::scene::surface::Surface;
    import bevy_glint::trace::surface_point::SurfacePoint;
    fn reflected_surface(surface: Surface, at: SurfacePoint) -> Surface {
        var changed = surface;
        // 2: the second `ReflectedMaterialPlugin` that `plugin` adds.
        changed.base_color *= select(1.0, bands(at.uv, at.seconds), at.material_type == 2u);
        return changed;
    }
";

impl Material for Lava {
    fn fragment_shader() -> ShaderRef {
        LAVA_SHADER.into()
    }
}

impl ReflectedMaterial for Lava {
    fn reflected(&self) -> StandardMaterial {
        StandardMaterial {
            base_color: self.heat.into(),
            unlit: true,
            ..default()
        }
    }
}

fn add_shaders(mut shaders: ResMut<Assets<Shader>>) {
    let mut add = |id: Handle<Shader>, source: &str, name: &str| {
        _ = shaders.insert(&id, Shader::from_wesl([source, BANDS].concat(), name));
    };
    add(LAVA_SHADER, LAVA, "lava.wesl");
    add(REFLECTED_SHADER, REFLECTED, "lava_in_reflections.wesl");
}

/// Turns about its own axis.
#[derive(Component)]
struct Turning;

fn setup(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut standard: ResMut<Assets<StandardMaterial>>,
    mut enamel: ResMut<Assets<Enamel>>,
    mut lava: ResMut<Assets<Lava>>,
    mut images: ResMut<Assets<Image>>,
) {
    let mirror = standard.add(StandardMaterial {
        metallic: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    });
    commands.spawn((
        Mesh3d(meshes.add(Rectangle::new(9.0, 4.0))),
        MeshMaterial3d(mirror),
        Transform::from_xyz(0.0, 2.0, -2.0),
    ));
    commands.spawn((
        Mesh3d(meshes.add(Plane3d::default().mesh().size(14.0, 14.0))),
        MeshMaterial3d(standard.add(Color::srgb(0.25, 0.27, 0.3))),
    ));
    let cube = meshes.add(Cuboid::from_length(1.1));
    commands.spawn((
        Turning,
        Mesh3d(cube.clone()),
        MeshMaterial3d(enamel.add(Enamel {
            base: Color::srgb(0.05, 0.25, 0.7).into(),
            extension: Wear {},
        })),
        Transform::from_xyz(-2.3, 0.9, 0.6),
    ));
    commands.spawn((
        Turning,
        Mesh3d(cube),
        MeshMaterial3d(lava.add(Lava {
            heat: LinearRgba::rgb(3.0, 0.6, 0.05),
        })),
        Transform::from_xyz(0.0, 0.9, 0.6),
    ));
    commands.spawn((
        Turning,
        Mesh3d(meshes.add(Torus::new(0.3, 0.7).mesh().minor_resolution(96).major_resolution(192))),
        ReflectedMesh3d(meshes.add(Torus::new(0.3, 0.7).mesh().minor_resolution(8).major_resolution(12))),
        MeshMaterial3d(standard.add(Color::srgb(0.8, 0.7, 0.2))),
        Transform::from_xyz(2.3, 1.0, 0.6).with_rotation(Quat::from_rotation_x(1.2)),
    ));
    commands.spawn((
        DirectionalLight {
            illuminance: 6_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-0.5, -1.0, -0.9), Vec3::Y),
    ));
    let [top, horizon] = [Color::srgb(0.35, 0.55, 0.95), Color::srgb(0.85, 0.88, 0.9)];
    let sky = EnvironmentMapLight::hemispherical_gradient(&mut images, top, horizon, Color::srgb(0.2, 0.2, 0.2));
    commands.spawn((
        Camera3d::default(),
        Transform::from_xyz(1.2, 2.6, 6.5).looking_at(Vec3::new(0.0, 1.1, 0.0), Vec3::Y),
        sky.with_intensity(700.0),
        ReflectionQuality::High,
    ));
}

fn turn(mut objects: Query<&mut Transform, With<Turning>>, time: Res<Time>) {
    for mut object in &mut objects {
        object.rotate_y(0.6 * time.delta_secs());
    }
}

fn glow(mut materials: ResMut<Assets<Lava>>, time: Res<Time>) {
    for (_, lava) in materials.iter_mut() {
        lava.heat.green = 0.6 + 0.4 * (2.0 * time.elapsed_secs()).sin();
    }
}

fn show_keys(mut window: Single<&mut Window>) {
    window.title = "Space: show the coarse mesh outside of the mirror, too".to_owned();
}

fn swap_meshes(mut objects: Query<(&mut Mesh3d, &ReflectedMesh3d)>, keys: Res<ButtonInput<KeyCode>>) {
    if keys.just_pressed(KeyCode::Space) {
        for (mut mesh, coarse) in &mut objects {
            mesh.0 = coarse.0.clone();
        }
    }
}
