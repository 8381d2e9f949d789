//! Surroundings of each view: exposure, ambient light, environment map, skybox and background. They are bind group 2 of the
//! passes that shade hits. `environment.wesl` is the GPU side.

use super::render_layers::SceneLayers;
use crate::{
    settings::{ClampedSettings, RayTracedReflections, ReflectedLayers, WantsReflections},
    vrs::BindGroupContents,
};
use bevy::{
    asset::AssetId,
    camera::{Camera, ClearColor, ClearColorConfig, Exposure, visibility::RenderLayers},
    color::{Color, LinearRgba},
    ecs::{entity::EntityHashMap, prelude::*},
    image::Image,
    light::{AmbientLight, EnvironmentMapLight, GlobalAmbientLight, Skybox},
    math::Quat,
    pbr::DfgLut,
    render::{
        render_asset::RenderAssets,
        render_resource::{
            BindGroup, BindGroupEntries, BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntries, Buffer,
            BufferDescriptor, BufferUsages, Extent3d, FilterMode, MipmapFilterMode, PipelineCache, Sampler,
            SamplerBindingType, SamplerDescriptor, ShaderStages, TextureDataOrder, TextureDescriptor, TextureDimension,
            TextureFormat, TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
            TextureViewId,
            binding_types::{sampler, texture_2d, texture_cube, uniform_buffer_sized},
        },
        renderer::{RenderDevice, RenderQueue},
        sync_world::RenderEntity,
        texture::GpuImage,
    },
};
use bytemuck::{Pod, Zeroable};

/// Flag of [`GpuEnvironment`].
pub const ENVIRONMENT_HAS_MAP: u32 = 1;
/// Flag of [`GpuEnvironment`].
pub const ENVIRONMENT_HAS_SKYBOX: u32 = 2;
/// Flag of [`GpuEnvironment`]: lights that cast shadows are tested by shadow rays.
pub const ENVIRONMENT_SHADOW_RAYS: u32 = 4;
/// Flag of [`GpuEnvironment`]: textures are read at [`GpuEnvironment::fixed_texture_level`].
pub const ENVIRONMENT_FIXED_TEXTURE_LEVEL: u32 = 8;

/// Flag of [`GpuEnvironment`]: Bevy was built with its table of split-sum factors.
pub const ENVIRONMENT_HAS_DFG_LUT: u32 = 16;

/// `EnvironmentUniform` of `environment.wesl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuEnvironment {
    /// Linear colour times brightness in cd/m^2, before exposure.
    pub ambient_color: [f32; 3],
    /// Factor from scene units to the values of the colour target.
    pub exposure: f32,
    /// Linear clear colour; exposed already.
    pub background: [f32; 3],
    /// `ENVIRONMENT_` flags, and the bits of the view's groups (`render_layers.rs`).
    pub flags: u32,
    /// Quaternion from the world to the cube maps.
    pub environment_rotation: [f32; 4],
    /// Quaternion from the world to the skybox.
    pub skybox_rotation: [f32; 4],
    /// Factor from the map's values to cd/m^2.
    pub environment_intensity: f32,
    /// Factor from the skybox's values to exposed radiance.
    pub skybox_brightness: f32,
    /// Level of the specular map for a perceptual roughness of 1.
    pub smallest_specular_mip: f32,
    /// Level for all textures, with [`ENVIRONMENT_FIXED_TEXTURE_LEVEL`].
    pub fixed_texture_level: f32,
}

const _: () = assert!(size_of::<GpuEnvironment>() == 80);

/// A view's environment in the render world, before its images are looked up.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct ViewEnvironment {
    uniform: GpuEnvironment,
    /// Diffuse and specular cube map.
    maps: Option<(AssetId<Image>, AssetId<Image>)>,
    skybox: Option<AssetId<Image>>,
}

fn finite(value: f32) -> f32 {
    if value.is_finite() { value.max(0.0) } else { 0.0 }
}

fn rgb(color: Color) -> [f32; 3] {
    let color = LinearRgba::from(color);
    [finite(color.red), finite(color.green), finite(color.blue)]
}

/// From the world into an image that is rotated by `rotation`.
fn into_image(rotation: Quat) -> [f32; 4] {
    let inverse = rotation.inverse();
    if inverse.is_finite() && rotation.length_squared() > 0.0 {
        inverse.normalize().to_array()
    } else {
        Quat::IDENTITY.to_array()
    }
}

impl ViewEnvironment {
    /// Gathers what surrounds a camera. `background` is its clear colour and `ambient` its ambient colour with brightness.
    fn new(
        settings: &ClampedSettings,
        exposure: f32,
        ambient: (Color, f32),
        background: Option<Color>,
        map: Option<&EnvironmentMapLight>,
        skybox: Option<&Skybox>,
    ) -> Self {
        let exposure = finite(exposure);
        let mut uniform = GpuEnvironment {
            ambient_color: rgb(ambient.0).map(|channel| channel * finite(ambient.1)),
            exposure,
            background: background.map_or([0.0; 3], rgb),
            environment_rotation: into_image(map.map_or(Quat::IDENTITY, |map| map.rotation)),
            skybox_rotation: into_image(skybox.map_or(Quat::IDENTITY, |skybox| skybox.rotation)),
            environment_intensity: finite(map.map_or(0.0, |map| map.intensity)),
            skybox_brightness: finite(skybox.map_or(0.0, |skybox| skybox.brightness) * exposure),
            ..Default::default()
        };
        if settings.shadow_rays {
            uniform.flags |= ENVIRONMENT_SHADOW_RAYS;
        }
        if let Some(level) = settings.fixed_mip {
            uniform.flags |= ENVIRONMENT_FIXED_TEXTURE_LEVEL;
            uniform.fixed_texture_level = finite(level);
        }
        Self {
            uniform,
            maps: map.map(|map| (map.diffuse_map.id(), map.specular_map.id())),
            skybox: skybox.and_then(|skybox| skybox.image.as_ref()).map(|image| image.id()),
        }
    }
}

/// Cameras that reflect, with what surrounds them.
pub(super) type ReflectingCameras<'w, 's> = Query<
    'w,
    's,
    (
        RenderEntity,
        &'static RayTracedReflections,
        &'static Camera,
        Option<&'static Exposure>,
        Option<&'static AmbientLight>,
        Option<&'static EnvironmentMapLight>,
        Option<&'static Skybox>,
        Option<&'static RenderLayers>,
        Option<&'static ReflectedLayers>,
    ),
>;

/// Gives every reflecting view its [`ViewEnvironment`] and takes it from the others. `scene_layers` are those of this frame.
pub(super) fn follow_environments(
    cameras: &ReflectingCameras,
    ambient: Option<&GlobalAmbientLight>,
    clear_color: Option<&ClearColor>,
    scene_layers: &SceneLayers,
    views: &mut Query<(Entity, &mut ViewEnvironment)>,
    commands: &mut Commands,
) {
    let mut known = 0;
    for (entity, settings, camera, exposure, own_ambient, map, skybox, drawn, reflected) in cameras {
        if !camera.is_active {
            continue;
        }
        let ambient = match (own_ambient, ambient) {
            (Some(light), _) => (light.color, light.brightness),
            (None, Some(light)) => (light.color, light.brightness),
            (None, None) => (Color::BLACK, 0.0),
        };
        let background = match camera.clear_color {
            ClearColorConfig::Custom(color) => Some(color),
            ClearColorConfig::Default => clear_color.map(|color| color.0),
            ClearColorConfig::None => None,
        };
        let exposure = exposure.copied().unwrap_or_default().exposure();
        let mut environment = ViewEnvironment::new(
            &ClampedSettings::from(settings),
            exposure,
            ambient,
            background,
            map,
            skybox,
        );
        environment.uniform.flags |= scene_layers.groups_of_camera(drawn, reflected);
        match views.get_mut(entity) {
            Ok((_, mut view)) => {
                known += 1;
                view.set_if_neq(environment);
            }
            Err(_) => {
                commands.entity(entity).insert(environment);
            }
        }
    }
    if known == views.iter().len() {
        return;
    }
    let is_active = |view: &Entity| {
        let mut active = cameras.iter().filter(|(_, _, camera, ..)| camera.is_active);
        active.any(|(entity, ..)| entity == *view)
    };
    for (view, _) in views.iter().filter(|(view, _)| !is_active(view)) {
        commands.entity(view).remove::<ViewEnvironment>();
    }
}

struct ViewBindings {
    buffer: Buffer,
    bind_group: BindGroup,
    contents: BindGroupContents,
    written: GpuEnvironment,
    views: [TextureViewId; 4],
}

/// The bind groups of all views, by render-world entity. A GPU resource: make it with `init_gpu_resource`.
#[derive(Resource)]
pub struct EnvironmentBindings {
    layout: BindGroupLayoutDescriptor,
    black: TextureView,
    /// The first face of the black cube, for a missing table.
    black_face: TextureView,
    sampler: Sampler,
    views: EntityHashMap<ViewBindings>,
}

fn environment_sampler() -> SamplerDescriptor<'static> {
    SamplerDescriptor {
        label: Some("glint_environment_sampler"),
        mag_filter: FilterMode::Linear,
        min_filter: FilterMode::Linear,
        mipmap_filter: MipmapFilterMode::Linear,
        ..Default::default()
    }
}

impl FromWorld for EnvironmentBindings {
    fn from_world(world: &mut World) -> Self {
        let device = world.resource::<RenderDevice>();
        let black = device.create_texture_with_data(
            world.resource::<RenderQueue>(),
            &TextureDescriptor {
                label: Some("glint_black_cube"),
                size: Extent3d {
                    depth_or_array_layers: 6,
                    ..Default::default()
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D2,
                format: TextureFormat::Rgba8Unorm,
                usage: TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
            TextureDataOrder::default(),
            &[0; 24],
        );
        let black_face = black.create_view(&TextureViewDescriptor {
            dimension: Some(TextureViewDimension::D2),
            array_layer_count: Some(1),
            ..Default::default()
        });
        Self {
            layout: layout_descriptor(),
            black_face,
            black: black.create_view(&TextureViewDescriptor {
                dimension: Some(TextureViewDimension::Cube),
                ..Default::default()
            }),
            sampler: device.create_sampler(&environment_sampler()),
            views: EntityHashMap::default(),
        }
    }
}

/// The layout of group 2, for compute and fragment passes alike.
pub fn layout_descriptor() -> BindGroupLayoutDescriptor {
    let cube = || texture_cube(TextureSampleType::Float { filterable: true });
    BindGroupLayoutDescriptor::new(
        "glint_environment",
        &BindGroupLayoutEntries::sequential(
            ShaderStages::COMPUTE | ShaderStages::FRAGMENT,
            (
                uniform_buffer_sized(false, std::num::NonZero::new(size_of::<GpuEnvironment>() as u64)),
                cube(),
                cube(),
                cube(),
                sampler(SamplerBindingType::Filtering),
                texture_2d(TextureSampleType::Float { filterable: true }),
            ),
        ),
    )
}

impl EnvironmentBindings {
    /// Group 2 of a view.
    pub fn bind_group(&self, view: Entity) -> Option<&BindGroup> {
        self.views.get(&view).map(|bindings| &bindings.bind_group)
    }

    /// Returns the contents of a view's bind group 2 while the view uses variable rate shading.
    pub(crate) fn contents(&self, view: Entity) -> Option<&BindGroupContents> {
        self.views.get(&view).map(|bindings| &bindings.contents)
    }
}

/// A cube map that can be bound, if the image is one.
fn cube(image: &GpuImage, device: &RenderDevice) -> bool {
    let dimension = image.texture_view_descriptor.as_ref().and_then(|view| view.dimension);
    dimension == Some(TextureViewDimension::Cube)
        && image.texture_descriptor.usage.contains(TextureUsages::TEXTURE_BINDING)
        && image.view_format().sample_type(None, Some(device.features()))
            == Some(TextureSampleType::Float { filterable: true })
}

/// The resources of a view's bind group, besides its uniform.
struct ViewMaps<'a> {
    diffuse: &'a TextureView,
    specular: &'a TextureView,
    skybox: &'a TextureView,
    table: &'a TextureView,
    sampler: &'a Sampler,
}

impl<'a> ViewMaps<'a> {
    /// The images of a view that can be bound, black ones in place of the others, and the uniform that says which is which. `table` is
    /// Bevy's table of the environment's BRDF.
    fn new(
        view: &ViewEnvironment,
        images: &'a RenderAssets<GpuImage>,
        table: Option<&'a GpuImage>,
        bindings: &'a EnvironmentBindings,
        device: &RenderDevice,
    ) -> (Self, GpuEnvironment) {
        let image = |id: AssetId<Image>| images.get(id).filter(|image| cube(image, device));
        let mut uniform = view.uniform;
        let mut maps = Self {
            diffuse: &bindings.black,
            specular: &bindings.black,
            skybox: &bindings.black,
            table: &bindings.black_face,
            sampler: &bindings.sampler,
        };
        if let Some((diffuse, specular)) = view.maps
            && let (Some(diffuse), Some(specular)) = (image(diffuse), image(specular))
        {
            (maps.diffuse, maps.specular) = (&diffuse.texture_view, &specular.texture_view);
            uniform.flags |= ENVIRONMENT_HAS_MAP;
            uniform.smallest_specular_mip = specular.texture_descriptor.mip_level_count.saturating_sub(1) as f32;
        }
        if let Some(image) = view.skybox.and_then(image) {
            maps.skybox = &image.texture_view;
            uniform.flags |= ENVIRONMENT_HAS_SKYBOX;
        }
        if let Some(image) = table {
            maps.table = &image.texture_view;
            uniform.flags |= ENVIRONMENT_HAS_DFG_LUT;
        }
        (maps, uniform)
    }

    fn ids(&self) -> [TextureViewId; 4] {
        [self.diffuse, self.specular, self.skybox, self.table].map(|view| view.id())
    }

    fn entries(&self, buffer: &'a Buffer) -> BindGroupEntries<'a, 6> {
        BindGroupEntries::sequential((
            buffer.as_entire_binding(),
            self.diffuse,
            self.specular,
            self.skybox,
            self.sampler,
            self.table,
        ))
    }

    /// Copies what a bind group was made of, for the pass with variable rate shading.
    fn fill(&self, contents: &mut BindGroupContents, buffer: &Buffer, bind_group: &BindGroup, device: &RenderDevice) {
        let samplers = [(&**self.sampler, environment_sampler())];
        contents.fill(device, bind_group, &self.entries(buffer), &samplers);
    }
}

impl ViewBindings {
    fn new(
        maps: &ViewMaps,
        uniform: GpuEnvironment,
        layout: &BindGroupLayout,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Self {
        let buffer = device.create_buffer(&BufferDescriptor {
            label: Some("glint_environment"),
            size: size_of::<GpuEnvironment>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        queue.write_buffer(&buffer, 0, bytemuck::bytes_of(&uniform));
        let bind_group = device.create_bind_group("glint_environment", layout, &maps.entries(&buffer));
        Self {
            buffer,
            bind_group,
            contents: BindGroupContents::default(),
            written: uniform,
            views: maps.ids(),
        }
    }

    fn write(&mut self, uniform: GpuEnvironment, queue: &RenderQueue) {
        if self.written != uniform {
            queue.write_buffer(&self.buffer, 0, bytemuck::bytes_of(&uniform));
            self.written = uniform;
        }
    }
}

/// Writes the uniforms and makes the bind groups. Belongs in `RenderSystems::PrepareBindGroups`.
pub fn prepare_environments(
    mut bindings: ResMut<EnvironmentBindings>,
    views: Query<(Entity, &ViewEnvironment, Option<&WantsReflections>)>,
    images: Res<RenderAssets<GpuImage>>,
    dfg: Option<Res<DfgLut>>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    pipelines: Res<PipelineCache>,
) {
    // Without Bevy's feature there is no image, or one of a single texel.
    let table = dfg
        .as_ref()
        .and_then(|dfg| images.get(&dfg.texture))
        .filter(|image| image.texture_descriptor.size.width > 1);
    let mut known = core::mem::take(&mut bindings.views);
    known.retain(|entity, _| views.contains(*entity));
    for (entity, view, wants) in &views {
        let (maps, uniform) = ViewMaps::new(view, &images, table, &bindings, &device);
        let current = known.remove(&entity).filter(|view| view.views == maps.ids());
        let mut current = current.unwrap_or_else(|| {
            let layout = pipelines.get_bind_group_layout(&bindings.layout);
            ViewBindings::new(&maps, uniform, &layout, &device, &queue)
        });
        current.write(uniform, &queue);
        if !wants.is_some_and(WantsReflections::uses_vrs) {
            current.contents.clear();
        } else if current.contents.is_missing() {
            maps.fill(&mut current.contents, &current.buffer, &current.bind_group, &device);
        }
        known.insert(entity, current);
    }
    bindings.views = known;
}
