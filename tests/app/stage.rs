//! Small scenes of a few objects before a mirror.

use crate::pictures::{PATIENCE, apps_of_both, warm_up};
use bevy::{
    asset::RenderAssetUsages,
    camera::{ClearColorConfig, Viewport},
    material::OpaqueRendererMethod,
    math::{UVec2, UVec3},
    pbr::{ExtendedMaterial, MaterialExtension},
    prelude::*,
    render::render_resource::{
        AsBindGroup, Extent3d, TextureDimension, TextureFormat, TextureViewDescriptor, TextureViewDimension,
    },
    shader::Shader,
};
use bevy_glint::{
    RayTracedReflections, ReflectionDenoiser, ReflectionStatus, ReflectionStatusReport, ReflectionTechnique,
    ReflectionTracerChoice,
};
use glint_scenes::{HeadlessApp, Output, SceneName, environment};

pub const SIZE: UVec2 = UVec2::new(96, 64);
pub const RED: [u8; 3] = [255, 0, 0];
pub const GREEN: [u8; 3] = [0, 255, 0];
pub const BLUE: [u8; 3] = [0, 0, 255];
/// Place of the camera before a mirror in the origin.
pub const BEFORE_THE_MIRROR: Transform = Transform::from_xyz(0.0, 0.0, 3.0);

pub fn unlit([red, green, blue]: [u8; 3]) -> StandardMaterial {
    unlit_color(Color::srgb_u8(red, green, blue))
}

pub fn unlit_color(base_color: Color) -> StandardMaterial {
    StandardMaterial {
        base_color,
        unlit: true,
        ..default()
    }
}

pub fn metal(perceptual_roughness: f32) -> StandardMaterial {
    StandardMaterial {
        metallic: 1.0,
        perceptual_roughness,
        ..default()
    }
}

/// Smooth colourless glass, with only its reflections visible.
pub fn clear_glass() -> StandardMaterial {
    StandardMaterial {
        base_color: Color::NONE,
        alpha_mode: AlphaMode::Premultiplied,
        reflectance: 1.0,
        perceptual_roughness: 0.0,
        ..default()
    }
}

/// An extension that no prepass draws.
#[derive(Asset, AsBindGroup, Reflect, Clone, Default)]
pub struct WithoutPrepass {}

impl MaterialExtension for WithoutPrepass {
    fn enable_prepass() -> bool {
        false
    }
}

pub type Unprepared = ExtendedMaterial<StandardMaterial, WithoutPrepass>;

/// A material that Bevy draws forward.
pub fn forward(material: StandardMaterial) -> StandardMaterial {
    StandardMaterial {
        opaque_render_method: OpaqueRendererMethod::Forward,
        ..material
    }
}

/// Covers the image of a camera that is some metres away.
pub fn sheet() -> Rectangle {
    Rectangle::new(40.0, 40.0)
}

/// At a distance before the camera at [`BEFORE_THE_MIRROR`], which looks along -z.
pub fn before(distance: f32) -> Transform {
    Transform::from_xyz(0.0, 0.0, BEFORE_THE_MIRROR.translation.z - distance)
}

/// Something of a colour behind the camera, and all around.
pub fn spawn_behind(app: &mut HeadlessApp, color: [u8; 3]) -> Entity {
    spawn_mesh(app, Rectangle::new(400.0, 400.0), unlit(color), behind(6.0))
}

/// Fills the image of a camera before the mirror.
pub fn wall() -> Rectangle {
    Rectangle::new(12.0, 12.0)
}

pub fn spawn_mesh(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
    spawn_of(app, mesh, material, at)
}

/// An object with a material of any type.
pub fn spawn_of<M: Material>(app: &mut HeadlessApp, mesh: impl Into<Mesh>, material: M, at: Transform) -> Entity {
    let (mesh, material) = (add(app, mesh.into()), add(app, material));
    app.world().spawn((Mesh3d(mesh), MeshMaterial3d(material), at)).id()
}

/// Behind the camera, at this distance from the mirror, and turned towards it.
pub fn behind(z: f32) -> Transform {
    Transform::from_xyz(0.0, 0.0, z).looking_to(Vec3::Z, Vec3::Y)
}

/// An image of these texels, by rows.
pub fn image(size: UVec2, format: TextureFormat, texels: Vec<u8>) -> Image {
    image_of_layers(size.extend(1), TextureDimension::D2, format, texels)
}

/// An image of one opaque texel.
pub fn texel([red, green, blue]: [u8; 3]) -> Image {
    let texels = vec![red, green, blue, 255];
    image(UVec2::ONE, TextureFormat::Rgba8UnormSrgb, texels)
}

/// A cube map of six faces with this number of texels in each direction.
pub fn cube_map(width: u32, texels: Vec<u8>) -> Image {
    let size = UVec3::new(width, width, 6);
    let mut image = image_of_layers(size, TextureDimension::D2, TextureFormat::Rgba8UnormSrgb, texels);
    image.texture_view_descriptor = Some(TextureViewDescriptor {
        dimension: Some(TextureViewDimension::Cube),
        ..default()
    });
    image
}

/// An image of several layers, or one with depth.
pub fn image_of_layers(size: UVec3, dimension: TextureDimension, format: TextureFormat, texels: Vec<u8>) -> Image {
    let size = Extent3d {
        width: size.x,
        height: size.y,
        depth_or_array_layers: size.z,
    };
    Image::new(size, dimension, texels, format, RenderAssetUsages::default())
}

pub fn add<A: Asset>(app: &mut HeadlessApp, asset: A) -> Handle<A> {
    app.world().resource_mut::<Assets<A>>().add(asset)
}

/// Adds a shader under a handle that materials have, or replaces it.
pub fn set_shader(app: &mut HeadlessApp, shader: &Handle<Shader>, source: impl Into<String>, path: &str) {
    let source = Shader::from_wesl(source.into(), path);
    let mut shaders = app.world().resource_mut::<Assets<Shader>>();
    shaders.insert(shader, source).unwrap();
}

/// Changes the material of an object.
pub fn edit_material(app: &mut HeadlessApp, object: Entity, change: impl FnOnce(&mut StandardMaterial)) {
    let world = app.world();
    let id = world.get::<MeshMaterial3d<StandardMaterial>>(object).unwrap().id();
    change(&mut world.resource_mut::<Assets<StandardMaterial>>().get_mut(id).unwrap());
}

/// Settings without noise, so that images can be compared.
pub fn plain() -> RayTracedReflections {
    RayTracedReflections {
        technique: ReflectionTechnique::Reference,
        denoiser: ReflectionDenoiser::OFF,
        full_resolution_mirrors: false,
        ..default()
    }
}

/// Settings with the whole denoiser, and with reflections on all surfaces.
pub fn denoised(technique: ReflectionTechnique) -> RayTracedReflections {
    RayTracedReflections {
        technique,
        roughness_cutoff: 1.0,
        ..default()
    }
}

/// The settings of a camera that reflects.
pub fn settings_of(app: &mut HeadlessApp, camera: Entity) -> Mut<'_, RayTracedReflections> {
    app.world().get_mut(camera).unwrap()
}

/// A mirror that fills the image of a camera before it, in the surroundings of a scene. Returns the camera.
pub fn spawn_mirror(app: &mut HeadlessApp, perceptual_roughness: f32, surroundings: SceneName) -> Entity {
    spawn_mesh(app, wall(), metal(perceptual_roughness), Transform::IDENTITY);
    spawn_camera(app, BEFORE_THE_MIRROR, surroundings)
}

/// A camera in the surroundings of a scene.
pub fn spawn_camera(app: &mut HeadlessApp, at: Transform, surroundings: SceneName) -> Entity {
    let environment = environment(surroundings, app.world());
    let camera = app.spawn_camera(at);
    environment.insert(&mut app.world().entity_mut(camera));
    camera
}

/// A test of one tracer, in an app that others use before and after it.
pub type Case = fn(&mut HeadlessApp, ReflectionTracerChoice);

/// Runs tests one after the other in an app of each tracer, because starting one with all its shaders takes longer than most of them.
pub fn share_app(cases: &[Case]) {
    for (tracer, mut app) in apps_of_both(SIZE, Output::Picture) {
        for case in cases {
            case(&mut app, tracer);
            clear(&mut app);
        }
    }
}

/// Removes everything that was spawned.
pub fn clear(app: &mut HeadlessApp) {
    let world = app.world();
    let mut placed = world.query_filtered::<Entity, With<Transform>>();
    let placed: Vec<Entity> = placed.iter(world).collect();
    for entity in placed {
        // Its parent might have removed it.
        _ = world.try_despawn(entity);
    }
    app.step(2);
}

/// Gives the left half of the image to the first camera, and the right half to the second.
pub fn share_picture(app: &mut HeadlessApp, cameras: [Entity; 2]) {
    let half = UVec2::new(SIZE.x / 2, SIZE.y);
    for (order, camera) in cameras.into_iter().enumerate() {
        let mut camera = app.world().get_mut::<Camera>(camera).unwrap();
        camera.order = order as isize;
        camera.viewport = Some(Viewport {
            physical_position: UVec2::new(order as u32 * half.x, 0),
            physical_size: half,
            ..default()
        });
        if order > 0 {
            camera.clear_color = ClearColorConfig::None;
        }
    }
}

pub fn report(app: &mut HeadlessApp) -> ReflectionStatusReport {
    app.world().resource::<ReflectionStatus>().report()
}

/// Waits until pipelines are compiled and meshes are built, then clears the history of a camera.
pub fn begin_anew(app: &mut HeadlessApp, camera: Entity) {
    warm_up(app);
    settings_of(app, camera).reset = true;
}

/// Clears the history of a camera. `history` counts those of a mean, which have different noise.
pub fn begin_history(app: &mut HeadlessApp, camera: Entity, history: u32) {
    app.step(37 * history);
    settings_of(app, camera).reset = true;
}

/// Bytes of the textures that front layers have.
pub fn layer_bytes(app: &mut HeadlessApp) -> u64 {
    let memory = report(app).view_memory;
    let parts = memory.iter().flat_map(|view| &view.parts);
    parts
        .filter(|(label, _)| label.starts_with("glint_front_layer"))
        .map(|(_, bytes)| bytes)
        .sum()
}

/// Renders frames until a condition is true. `what` is what is wrong if it never is.
#[track_caller]
pub fn until(app: &mut HeadlessApp, what: &str, mut is: impl FnMut(&mut HeadlessApp) -> bool) {
    for _ in 0..PATIENCE {
        if is(app) {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
        app.step(1);
    }
    panic!("{what}: {}", report(app));
}

/// Waits until all merging is done, and masked objects have their micromaps.
#[track_caller]
pub fn until_at_rest(app: &mut HeadlessApp) -> ReflectionStatusReport {
    app.step(3);
    until(app, "merging goes on", |app| {
        let report = report(app);
        !report.merges_pending && !report.micromaps_pending
    });
    report(app)
}

/// Renders one frame and waits for the GPU, so that the next frame finds the report.
pub fn frame(app: &mut HeadlessApp) {
    app.step(1);
    app.wait_until_idle().unwrap();
}
