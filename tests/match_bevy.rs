//! A surface that our shading sees in a reflection has the colour that Bevy's deferred path gives it when it is seen directly.
//!
//! One pixel of a plane is rendered by Bevy, and the same point is shaded by `load_surface` and `shade` in a compute shader, with the
//! lights and the environment that our extraction found. Needs a GPU; passes without having run where there is none.

#[path = "common/wesl.rs"]
mod wesl;

use std::sync::{Arc, Mutex};

use bevy::{
    camera::{Hdr, RenderTarget},
    core_pipeline::{prepass::*, tonemapping::{DebandDither, Tonemapping}},
    light::GlobalAmbientLight,
    pbr::DefaultOpaqueRendererMethod,
    prelude::*,
    render::{
        ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderPlugin, RenderSystems,
        gpu_readback::{Readback, ReadbackComplete},
        render_resource::*,
        renderer::{RenderDevice, RenderQueue},
        sync_world::RenderEntity,
    },
    window::ExitCondition,
    winit::WinitPlugin,
};
use bevy_glint::scene::{environment::*, gpu_types::*, lights::*, materials::pack_material};

const SIZE: u32 = 33;

const SHADER: &str = r#"
import package::scene::types::{Ray, Hit};
import package::scene::surface::load_surface;
import package::scene::shading::shade;

@group(0) @binding(0) var<storage, read_write> output: array<vec4<f32>>;
@group(0) @binding(1) var<uniform> ray: Ray;

@compute @workgroup_size(1)
fn main() {
    let hit = Hit(ray.t_max, 0u, 0u, true, vec2<f32>(1.0 / 3.0));
    let surface = load_surface(hit, ray, 0.0, 0.001);
    output[0] = vec4<f32>(shade(surface, -ray.direction), 1.0);
}
"#;

#[derive(Component, Clone)]
struct Marked;

impl EnvironmentSettings for Marked {
    fn hit_shading(&self) -> HitShading {
        HitShading { shadow_rays: true, texture_level: TextureLevel::RayCone }
    }
}

struct Stage {
    app: App,
    camera: Entity,
    material: Handle<StandardMaterial>,
    pixels: Arc<Mutex<Vec<u8>>>,
    eye: Vec3,
}

impl Stage {
    fn new() -> Option<Self> {
        let mut app = App::new();
        let window = WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() };
        let render = RenderPlugin { synchronous_pipeline_compilation: true, ..default() };
        app.add_plugins(
            DefaultPlugins
                .set(window)
                .set(render)
                .disable::<WinitPlugin>()
                .disable::<bevy::render::pipelined_rendering::PipelinedRenderingPlugin>(),
        );
        app.insert_resource(DefaultOpaqueRendererMethod::deferred());
        app.insert_resource(GlobalAmbientLight::NONE);
        let render_app = app.get_sub_app_mut(RenderApp)?;
        render_app
            .init_resource::<ExtractedLights>()
            .init_gpu_resource::<EnvironmentBindings>()
            .add_systems(ExtractSchedule, (extract_lights, extract_environments::<Marked>))
            .add_systems(Render, prepare_environments.in_set(RenderSystems::PrepareBindGroups));
        app.finish();
        app.cleanup();

        let world = app.world_mut();
        let mut target = Image::new_target_texture(SIZE, SIZE, TextureFormat::Rgba16Float, None);
        target.texture_descriptor.usage |= TextureUsages::COPY_SRC;
        let target = world.resource_mut::<Assets<Image>>().add(target);
        let mesh = world.resource_mut::<Assets<Mesh>>().add(Plane3d::default().mesh().size(10.0, 10.0));
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(StandardMaterial::default());
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material.clone())));
        let eye = Vec3::new(0.3, 2.0, 1.5);
        let camera = (
            Camera3d::default(),
            Marked,
            Hdr,
            Msaa::Off,
            (DepthPrepass, DeferredPrepass),
            Tonemapping::None,
            DebandDither::Disabled,
            RenderTarget::Image(target.clone().into()),
            Transform::from_translation(eye).looking_at(Vec3::ZERO, Vec3::Y),
        );
        let camera = world.spawn(camera).id();
        let pixels = Arc::new(Mutex::new(Vec::new()));
        let sink = pixels.clone();
        world
            .spawn(Readback::texture(target))
            .observe(move |event: On<ReadbackComplete>| sink.lock().unwrap().clone_from(&event.event().data));
        Some(Self { app, camera, material, pixels, eye })
    }

    /// Bevy's colour of the middle pixel and ours.
    fn compare(&mut self, material: StandardMaterial, wgsl: &str) -> ([f32; 3], [f32; 3]) {
        let packed = pack_material(&material);
        *self.app.world_mut().resource_mut::<Assets<StandardMaterial>>().get_mut(&self.material).unwrap() = material;
        for _ in 0..12 {
            self.app.update();
            let device = self.app.sub_app(RenderApp).world().resource::<RenderDevice>().clone();
            device.wgpu_device().poll(PollType::wait_indefinitely()).unwrap();
        }
        let pixels = self.pixels.lock().unwrap();
        let start = ((SIZE / 2 * SIZE + SIZE / 2) * 8) as usize;
        let theirs = [0, 2, 4].map(|i| half(u16::from_le_bytes([pixels[start + i], pixels[start + i + 1]])));
        drop(pixels);
        (theirs, self.shade(packed, wgsl))
    }

    /// Shaders load in the background: renders until an unlit surface shows.
    fn warm_up(&mut self, wgsl: &str) {
        for _ in 0..200 {
            let unlit = StandardMaterial { unlit: true, ..default() };
            if self.compare(unlit, wgsl).0 != [0.0; 3] {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        panic!("Bevy's picture stays black");
    }

    fn shade(&self, material: GpuMaterial, wgsl: &str) -> [f32; 3] {
        let world = self.app.sub_app(RenderApp).world();
        let device = world.resource::<RenderDevice>();
        let queue = world.resource::<RenderQueue>();
        let buffer = |bytes: &[u8], usage: BufferUsages| {
            let usage = usage | BufferUsages::STORAGE | BufferUsages::UNIFORM;
            device.create_buffer_with_data(&BufferInitDescriptor { label: None, contents: bytes, usage })
        };
        let storage = |bytes: &[u8]| buffer(bytes, BufferUsages::empty());

        // One triangle around the origin that looks up.
        let mut geometry = vec![3, 1, 0, 12, 21, 24, 0, 0, 0, 0, 0, 0];
        geometry.extend([[-2.0f32, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 0.0, -2.0]].iter().flatten().map(|v| v.to_bits()));
        geometry.extend([0, 1, 2, 0x7fff_0000, 0x7fff_0000, 0x7fff_0000]);
        let identity = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        let flags = INSTANCE_CULL_BACK;
        let instance =
            GpuInstance { world_from_object: identity, object_from_world: identity, flags, ..Default::default() };
        let lights = &world.resource::<ExtractedLights>().lights;
        let scene =
            GpuSceneCounts { light_count: lights.len() as u32, instance_count: 1, material_count: 1, ..Default::default() };
        let mut light_data = lights.clone();
        light_data.resize(light_data.len().max(1), Default::default());
        let direction = -self.eye.normalize();
        let ray = [self.eye.x, self.eye.y, self.eye.z, 0.0, direction.x, direction.y, direction.z, self.eye.length()];

        let output = buffer(&[0; 16], BufferUsages::COPY_SRC);
        let readback = device.create_buffer(&BufferDescriptor {
            label: None,
            size: 16,
            usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let white = device
            .create_texture_with_data(
                queue,
                &TextureDescriptor {
                    label: None,
                    size: Extent3d::default(),
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: TextureDimension::D2,
                    format: TextureFormat::Rgba8Unorm,
                    usage: TextureUsages::TEXTURE_BINDING,
                    view_formats: &[],
                },
                TextureDataOrder::default(),
                &[255; 4],
            )
            .create_view(&TextureViewDescriptor { dimension: Some(TextureViewDimension::D2Array), ..default() });
        let sampler = device.create_sampler(&SamplerDescriptor::default());

        let source = ShaderSource::Wgsl(wgsl.into());
        let module = device.create_and_validate_shader_module(ShaderModuleDescriptor { label: None, source });
        let storage_layout = binding_types::storage_buffer_read_only_sized(false, None);
        let uniform_layout = binding_types::uniform_buffer_sized(false, None);
        let float = TextureSampleType::Float { filterable: true };
        let pipelines = world.resource::<PipelineCache>();
        let own = BindGroupLayoutDescriptor::new(
            "own",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::COMPUTE,
                (binding_types::storage_buffer_sized(false, None), uniform_layout),
            ),
        );
        let shared = BindGroupLayoutDescriptor::new(
            "scene",
            &BindGroupLayoutEntries::with_indices(
                ShaderStages::COMPUTE,
                (
                    (0, storage_layout),
                    (1, storage_layout),
                    (2, storage_layout),
                    (3, storage_layout),
                    (4, uniform_layout),
                    (8, binding_types::texture_2d_array(float)),
                    (9, binding_types::sampler(SamplerBindingType::Filtering)),
                ),
            ),
        );
        let environment = world.resource::<EnvironmentBindings>();
        let layouts = [&own, &shared, environment.layout()].map(|layout| pipelines.get_bind_group_layout(layout));
        let pipeline_layout = device.create_pipeline_layout(&PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&layouts[0]), Some(&layouts[1]), Some(&layouts[2])],
            immediate_size: 0,
        });
        let pipeline = device.create_compute_pipeline(&RawComputePipelineDescriptor {
            label: None,
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some("main"),
            compilation_options: Default::default(),
            cache: None,
        });
        let entity = self.app.world().get::<RenderEntity>(self.camera).unwrap().id();
        let group =
            |index: usize, entries: &[BindGroupEntry]| device.create_bind_group(None, &layouts[index], entries);
        let (ray, geometry) = (storage(bytemuck::cast_slice(&ray)), storage(bytemuck::cast_slice(&geometry)));
        let (instance, material) = (storage(bytemuck::bytes_of(&instance)), storage(bytemuck::bytes_of(&material)));
        let (lights, scene) = (storage(bytemuck::cast_slice(&light_data)), storage(bytemuck::bytes_of(&scene)));
        let groups = [
            group(0, &BindGroupEntries::sequential((output.as_entire_binding(), ray.as_entire_binding()))),
            group(
                1,
                &BindGroupEntries::with_indices((
                    (0, geometry.as_entire_binding()),
                    (1, instance.as_entire_binding()),
                    (2, material.as_entire_binding()),
                    (3, lights.as_entire_binding()),
                    (4, scene.as_entire_binding()),
                    (8, &white),
                    (9, &sampler),
                )),
            ),
            environment.bind_group(entity).unwrap().clone(),
        ];
        let mut encoder = device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&pipeline);
            for (index, group) in groups.iter().enumerate() {
                pass.set_bind_group(index as u32, &**group, &[]);
            }
            pass.dispatch_workgroups(1, 1, 1);
        }
        encoder.copy_buffer_to_buffer(&output, 0, &readback, 0, 16);
        queue.submit([encoder.finish()]);
        readback.slice(..).map_async(MapMode::Read, |result| result.unwrap());
        device.wgpu_device().poll(PollType::wait_indefinitely()).unwrap();
        let data = readback.slice(..).get_mapped_range().unwrap().to_vec();
        [0, 4, 8].map(|i| f32::from_le_bytes([data[i], data[i + 1], data[i + 2], data[i + 3]]))
    }
}

fn half(bits: u16) -> f32 {
    let magnitude = bits & 0x7fff;
    let value = if magnitude < 0x0400 {
        f32::from(magnitude) * 2.0f32.powi(-24)
    } else {
        f32::from_bits((u32::from(magnitude) << 13) + (112 << 23))
    };
    if bits & 0x8000 == 0 { value } else { -value }
}

/// A colour that the G-buffer keeps exactly.
fn stored(level: u8) -> f32 {
    (f32::from(level) / 255.0).powf(2.2)
}

#[test]
fn colours_match_bevys_deferred_lighting() {
    let trace = include_str!("stubs/trace.wesl");
    let geometry = include_str!("stubs/geometry.wesl");
    let replaced = [("scene/trace.wesl", trace), ("scene/geometry.wesl", geometry)];
    let wgsl = wesl::flatten(SHADER, &replaced, &[]);
    let Some(mut stage) = Stage::new() else { return };

    let rough = 128.0 / 255.0;
    let color = Color::linear_rgb(stored(200), stored(120), stored(60));
    let plastic =
        StandardMaterial { base_color: color, perceptual_roughness: rough, reflectance: rough, ..default() };
    let metal = StandardMaterial { metallic: 1.0, ..plastic.clone() };
    let shiny = StandardMaterial { perceptual_roughness: 51.0 / 255.0, ..plastic.clone() };
    let glowing = StandardMaterial { emissive: LinearRgba::rgb(0.25, 0.5, 2.0), ..plastic.clone() };
    let unlit = StandardMaterial { unlit: true, ..plastic.clone() };
    let materials =
        [("plastic", plastic), ("metal", metal), ("shiny", shiny), ("glowing", glowing), ("unlit", unlit)];

    let place = Transform::from_xyz(-0.4, 1.5, -1.2);
    type Spawn = Box<dyn Fn(&mut World, Entity) -> Entity>;
    let lights: Vec<(&str, Spawn)> = vec![
        ("no light", Box::new(|world, _| world.spawn_empty().id())),
        ("directional light", Box::new(move |world, _| {
            let light = DirectionalLight { illuminance: 3000.0, color: Color::linear_rgb(1.0, 0.8, 0.5), ..default() };
            world.spawn((light, place.looking_at(Vec3::ZERO, Vec3::Y))).id()
        })),
        ("point light", Box::new(move |world, _| {
            world.spawn((PointLight { intensity: 200_000.0, range: 5.0, ..default() }, place)).id()
        })),
        ("sphere light", Box::new(move |world, _| {
            world.spawn((PointLight { intensity: 200_000.0, radius: 0.4, ..default() }, place)).id()
        })),
        ("spot light", Box::new(move |world, _| {
            let light = SpotLight { intensity: 400_000.0, inner_angle: 0.1, outer_angle: 0.5, ..default() };
            world.spawn((light, place.looking_at(Vec3::new(0.4, 0.0, 0.2), Vec3::Y))).id()
        })),
        ("ambient light", Box::new(|world, camera| {
            world.entity_mut(camera).insert(AmbientLight { brightness: 300.0, ..default() });
            world.spawn_empty().id()
        })),
        ("environment map", Box::new(|world, camera| {
            world.entity_mut(camera).insert(AmbientLight { brightness: 0.0, ..default() });
            let mut map = EnvironmentMapLight::hemispherical_gradient(
                &mut world.resource_mut::<Assets<Image>>(),
                Color::linear_rgb(0.3, 0.5, 1.0),
                Color::linear_rgb(0.9, 0.8, 0.7),
                Color::linear_rgb(0.2, 0.1, 0.05),
            );
            map.intensity = 900.0;
            map.rotation = Quat::from_rotation_x(0.7);
            world.entity_mut(camera).insert(map);
            world.spawn_empty().id()
        })),
    ];

    stage.warm_up(&wgsl);
    let mut failures = Vec::new();
    for (light, spawn) in &lights {
        let camera = stage.camera;
        let entity = spawn(stage.app.world_mut(), camera);
        for (name, material) in &materials {
            let (theirs, ours) = stage.compare(material.clone(), &wgsl);
            let close = theirs.iter().zip(&ours).all(|(a, b)| (a - b).abs() <= 0.01 * a.abs().max(b.abs()) + 1e-4);
            println!("{light}, {name}: Bevy {theirs:?}, ours {ours:?}");
            if !close {
                failures.push(format!("{light}, {name}: Bevy {theirs:?}, ours {ours:?}"));
            }
            let dark = *light == "no light" && !matches!(*name, "unlit" | "glowing");
            assert_eq!(dark, theirs == [0.0; 3], "{light}, {name}: Bevy's pixel is {theirs:?}");
        }
        stage.app.world_mut().despawn(entity);
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
