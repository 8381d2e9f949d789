//! Bind group 2 of each view.

use super::{
    ENVIRONMENT_HAS_DFG_LUT, ENVIRONMENT_HAS_MAP, ENVIRONMENT_HAS_SKYBOX, GpuEnvironment, MANY_TEXTURES,
    ViewEnvironment,
};
use crate::{scene::atmosphere::GpuAir, settings::WantsReflections, vrs::BindGroupContents};
use bevy::{
    asset::AssetId,
    ecs::{entity::EntityHashMap, prelude::*, system::SystemParam},
    image::Image,
    pbr::{AreaLightLuts, DfgLut, GpuScatteringMedium, resources::AtmosphereTextures},
    render::{
        render_asset::RenderAssets,
        render_resource::{
            BindGroup, BindGroupEntries, BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntries, Buffer,
            BufferDescriptor, BufferUsages, Extent3d, FilterMode, MipmapFilterMode, PipelineCache, Sampler,
            SamplerBindingType, SamplerDescriptor, SamplerId, ShaderStages, Texture, TextureDataOrder,
            TextureDescriptor, TextureDimension, TextureFormat, TextureSampleType, TextureUsages, TextureView,
            TextureViewDescriptor, TextureViewDimension, TextureViewId,
            binding_types::{sampler, texture_2d, texture_2d_array, texture_3d, texture_cube, uniform_buffer_sized},
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
};

/// Number of bindings in the group. The last ones are the density of fog, its sampler, and the tables of the atmosphere's medium.
const BINDINGS: usize = if MANY_TEXTURES { 14 } else { BINDINGS_IN_BROWSERS };
const BINDINGS_IN_BROWSERS: usize = 9;

struct ViewBindings {
    buffer: Buffer,
    bind_group: BindGroup,
    contents: BindGroupContents,
    written: GpuEnvironment,
    id: EnvironmentId,
}

/// The images of a view's environment. An image can get a different sampler and keep its texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EnvironmentId {
    views: [TextureViewId; 11],
    density_sampler: SamplerId,
}

/// The bind groups of all views, by render-world entity. Create this GPU resource with `init_gpu_resource`.
#[derive(Resource)]
pub struct EnvironmentBindings {
    layout: BindGroupLayoutDescriptor,
    black: TextureView,
    /// The first face of the black cube, for a missing table.
    black_face: TextureView,
    /// All faces of the black cube, for a missing table with layers.
    black_layers: TextureView,
    /// A white texel, for a missing fog density.
    even: TextureView,
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
        let even = device.create_texture_with_data(
            world.resource::<RenderQueue>(),
            &TextureDescriptor {
                label: Some("glint_even_density"),
                size: Extent3d::default(),
                mip_level_count: 1,
                sample_count: 1,
                dimension: TextureDimension::D3,
                format: TextureFormat::R8Unorm,
                usage: TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            },
            TextureDataOrder::default(),
            &[255],
        );
        Self {
            layout: layout_descriptor(),
            even: even.create_view(&TextureViewDescriptor::default()),
            black_face,
            black_layers: black.create_view(&TextureViewDescriptor {
                dimension: Some(TextureViewDimension::D2Array),
                ..Default::default()
            }),
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
    layout_of(BINDINGS)
}

/// As above, in browsers.
#[cfg(test)]
pub fn layout_in_browsers() -> BindGroupLayoutDescriptor {
    layout_of(BINDINGS_IN_BROWSERS)
}

fn layout_of(bindings: usize) -> BindGroupLayoutDescriptor {
    let cube = || texture_cube(TextureSampleType::Float { filterable: true });
    let table = || texture_2d(TextureSampleType::Float { filterable: true });
    let entries = BindGroupLayoutEntries::sequential(
        ShaderStages::COMPUTE | ShaderStages::FRAGMENT,
        (
            uniform_buffer_sized(false, std::num::NonZero::new(size_of::<GpuEnvironment>() as u64)),
            cube(),
            cube(),
            cube(),
            sampler(SamplerBindingType::Filtering),
            table(),
            table(),
            table(),
            texture_2d_array(TextureSampleType::Float { filterable: true }),
            texture_3d(TextureSampleType::Float { filterable: true }),
            sampler(SamplerBindingType::Filtering),
            table(),
            table(),
            table(),
        ),
    );
    BindGroupLayoutDescriptor::new("glint_environment", &entries[..bindings])
}

impl EnvironmentBindings {
    /// Group 2 of a view.
    pub fn bind_group(&self, view: Entity) -> Option<&BindGroup> {
        self.views.get(&view).map(|bindings| &bindings.bind_group)
    }

    /// The images of a view's environment, from the second frame on.
    pub(crate) fn id(&self, view: Entity) -> Option<EnvironmentId> {
        self.views.get(&view).map(|bindings| bindings.id)
    }

    /// Returns the contents of a view's bind group 2 while the view uses variable rate shading.
    pub(crate) fn contents(&self, view: Entity) -> Option<&BindGroupContents> {
        self.views.get(&view).map(|bindings| &bindings.contents)
    }
}

/// Returns whether an image can be bound as a cube map.
fn cube(image: &GpuImage, device: &RenderDevice) -> bool {
    let dimension = image.texture_view_descriptor.as_ref().and_then(|view| view.dimension);
    dimension == Some(TextureViewDimension::Cube)
        && image.texture_descriptor.usage.contains(TextureUsages::TEXTURE_BINDING)
        && image.view_format().sample_type(None, Some(device.features()))
            == Some(TextureSampleType::Float { filterable: true })
}

/// Returns whether an image can be bound as a density texture.
fn solid(image: &GpuImage, device: &RenderDevice) -> bool {
    image.texture_descriptor.dimension == TextureDimension::D3
        && image.texture_descriptor.usage.contains(TextureUsages::TEXTURE_BINDING)
        && image.view_format().sample_type(None, Some(device.features()))
            == Some(TextureSampleType::Float { filterable: true })
}

/// Bevy's tables that all views share, and its atmosphere media. Without its cargo features, tables are missing or have a single texel.
#[derive(SystemParam)]
pub struct Tables<'w> {
    split_sum: Option<Res<'w, DfgLut>>,
    area_lights: Option<Res<'w, AreaLightLuts>>,
    media: Option<Res<'w, RenderAssets<GpuScatteringMedium>>>,
}

impl Tables<'_> {
    /// The medium of a view's atmosphere, if it can be bound.
    fn medium(&self, view: &ViewEnvironment, device: &RenderDevice) -> Option<&GpuScatteringMedium> {
        let medium = self.media.as_ref()?.get(view.medium?)?;
        let is_filterable = |texture: &Texture| {
            let sampled = texture.format().sample_type(None, Some(device.features()));
            sampled == Some(TextureSampleType::Float { filterable: true })
        };
        (is_filterable(&medium.density_lut) && is_filterable(&medium.scattering_lut)).then_some(medium)
    }

    fn split_sum<'a>(&self, images: &'a RenderAssets<GpuImage>) -> Option<&'a GpuImage> {
        let image = images.get(&self.split_sum.as_ref()?.texture)?;
        (image.texture_descriptor.size.width > 1).then_some(image)
    }

    fn area_lights<'a>(&self, images: &'a RenderAssets<GpuImage>) -> Option<&'a GpuImage> {
        let image = images.get(&self.area_lights.as_ref()?.image)?;
        (image.texture_descriptor.size.width > 1).then_some(image)
    }
}

/// The resources of a view's bind group, besides its uniform.
struct ViewMaps<'a> {
    diffuse: &'a TextureView,
    specular: &'a TextureView,
    skybox: &'a TextureView,
    table: &'a TextureView,
    /// Bevy's tables of the atmosphere: transmittance, and the sky.
    air: [&'a TextureView; 2],
    /// Its tables of the medium: multiple scattering, density, and scattering.
    medium: [&'a TextureView; 3],
    /// Bevy's table for rectangular lights.
    area_lights: &'a TextureView,
    fog_density: (&'a TextureView, &'a Sampler),
    sampler: &'a Sampler,
}

impl<'a> ViewMaps<'a> {
    /// Looks up the images of a view that can be bound, with black ones for the others, and sets the uniform's flags accordingly.
    fn new(
        view: &ViewEnvironment,
        images: &'a RenderAssets<GpuImage>,
        tables: &'a Tables,
        air: Option<&'a AtmosphereTextures>,
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
            air: [&bindings.black_face; 2],
            medium: [&bindings.black_face; 3],
            area_lights: &bindings.black_layers,
            fog_density: (&bindings.even, &bindings.sampler),
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
        let density = view.fog_density.and_then(|id| images.get(id));
        if let Some(image) = density.filter(|image| solid(image, device)) {
            maps.fog_density = (&image.texture_view, &image.sampler);
        }
        if let Some(image) = tables.split_sum(images) {
            maps.table = &image.texture_view;
            uniform.flags |= ENVIRONMENT_HAS_DFG_LUT;
        }
        if let Some(image) = tables.area_lights(images) {
            maps.area_lights = &image.texture_view;
        }
        match air {
            Some(air) => maps.air = [&air.transmittance_lut, &air.sky_view_lut].map(|table| &table.default_view),
            None => uniform.air = GpuAir::default(),
        }
        match (air, tables.medium(view, device)) {
            (Some(air), Some(medium)) => {
                let scattered_often = &air.multiscattering_lut.default_view;
                maps.medium = [scattered_often, &medium.density_lut_view, &medium.scattering_lut_view];
            }
            _ => uniform.aerial_samples = 0,
        }
        (maps, uniform)
    }

    fn id(&self) -> EnvironmentId {
        let [transmittance, sky] = self.air;
        let [scattered_often, density, scattering] = self.medium;
        let views = [
            self.diffuse,
            self.specular,
            self.skybox,
            self.table,
            transmittance,
            sky,
            self.area_lights,
            self.fog_density.0,
            scattered_often,
            density,
            scattering,
        ];
        EnvironmentId {
            views: views.map(|view| view.id()),
            density_sampler: self.fog_density.1.id(),
        }
    }

    fn entries(&self, buffer: &'a Buffer) -> BindGroupEntries<'a, 14> {
        BindGroupEntries::sequential((
            buffer.as_entire_binding(),
            self.diffuse,
            self.specular,
            self.skybox,
            self.sampler,
            self.table,
            self.air[0],
            self.air[1],
            self.area_lights,
            self.fog_density.0,
            self.fog_density.1,
            self.medium[0],
            self.medium[1],
            self.medium[2],
        ))
    }

    /// Copies the inputs of a bind group, for the pass with variable rate shading.
    fn fill(&self, contents: &mut BindGroupContents, buffer: &Buffer, bind_group: &BindGroup, device: &RenderDevice) {
        // Shaders of that pass read neither the density of fog nor the medium of the atmosphere.
        let samplers = [self.sampler, self.fog_density.1].map(|sampler| (&**sampler, environment_sampler()));
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
        let bind_group = device.create_bind_group("glint_environment", layout, &maps.entries(&buffer)[..BINDINGS]);
        Self {
            buffer,
            bind_group,
            contents: BindGroupContents::default(),
            written: uniform,
            id: maps.id(),
        }
    }

    fn write(&mut self, uniform: GpuEnvironment, queue: &RenderQueue) {
        if self.written != uniform {
            queue.write_buffer(&self.buffer, 0, bytemuck::bytes_of(&uniform));
            self.written = uniform;
        }
    }
}

/// Writes the uniforms and creates the bind groups. Runs in `RenderSystems::PrepareBindGroups`.
pub fn prepare_environments(
    mut bindings: ResMut<EnvironmentBindings>,
    views: Query<(
        Entity,
        &ViewEnvironment,
        Option<&WantsReflections>,
        Option<&AtmosphereTextures>,
    )>,
    images: Res<RenderAssets<GpuImage>>,
    tables: Tables,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    pipelines: Res<PipelineCache>,
) {
    let mut known = core::mem::take(&mut bindings.views);
    known.retain(|entity, _| views.contains(*entity));
    for (entity, view, wants, air) in &views {
        let (maps, uniform) = ViewMaps::new(view, &images, &tables, air, &bindings, &device);
        let is_current = |view: &ViewBindings| view.id == maps.id();
        let current = known.remove(&entity).filter(is_current);
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
