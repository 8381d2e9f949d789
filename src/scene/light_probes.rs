//! Light probes for hits: Bevy's reflection probes and irradiance volumes. All probes of the scene are used, since rays
//! hit surfaces outside the camera's view. `light_probes.wesl` is the GPU side.

mod marks;

use super::{bvh::invert, change::Change, gpu_types::GpuLightProbe, upload::StorageSlice};
use crate::{device::ReflectionTextureMode, settings::RayTracedReflections};
use bevy::{
    asset::AssetId,
    camera::{Camera, visibility::InheritedVisibility},
    ecs::{prelude::*, system::SystemParam},
    image::Image,
    light::{EnvironmentMapLight, IrradianceVolume, LightProbe, ParallaxCorrection},
    log::warn_once,
    math::{Affine3A, Vec3, Vec3A},
    render::{
        render_asset::RenderAssets,
        render_resource::{
            BindGroupLayoutEntryBuilder, Buffer, Extent3d, TextureDataOrder, TextureDescriptor, TextureDimension,
            TextureFormat, TextureSampleType, TextureUsages, TextureView, TextureViewDescriptor, TextureViewDimension,
            WgpuTextureView,
            binding_types::{texture_3d, texture_cube},
        },
        renderer::{RenderDevice, RenderQueue},
        texture::GpuImage,
    },
    transform::components::GlobalTransform,
};
use core::num::NonZero;
use marks::Marks;

/// Maximum number of probes of one kind in hit shading; `light_probes.wesl` has the same number. Bevy takes half as many for each view.
///
/// A reflection probe adds two textures and a volume one, and each hit tests all of them.
const MAX_PROBES: usize = 16;

/// A probe in the render world, before its images are looked up.
#[derive(Clone, Debug, PartialEq)]
struct ProbeSource {
    data: GpuLightProbe,
    /// Diffuse and specular map, or the voxels twice.
    images: [AssetId<Image>; 2],
}

/// The light probes of the scene in the render world.
#[derive(Resource, Default, PartialEq)]
pub struct ExtractedLightProbes {
    reflection_probes: Vec<ProbeSource>,
    irradiance_volumes: Vec<ProbeSource>,
}

impl ExtractedLightProbes {
    /// Returns whether a probe gets its light from an image.
    pub(super) fn shows(&self, image: AssetId<Image>) -> bool {
        let mut probes = self.reflection_probes.iter().chain(&self.irradiance_volumes);
        probes.any(|probe| probe.images.contains(&image))
    }
}

/// Returns `None` if the probe gives no light, or has no box.
fn probe(
    world_from_probe: Affine3A,
    probe: &LightProbe,
    intensity: f32,
    parallax: Option<&ParallaxCorrection>,
    images: [AssetId<Image>; 2],
) -> Option<ProbeSource> {
    let probe_from_world = bytemuck::cast(invert(&world_from_probe)?.rows);
    let bounds = match parallax {
        Some(ParallaxCorrection::Auto) => Some(Vec3::splat(0.5)),
        Some(ParallaxCorrection::Custom(bounds)) => Some(*bounds).filter(|bounds| bounds.is_finite()),
        Some(ParallaxCorrection::None) | None => None,
    };
    let is_valid = intensity.is_finite() && intensity >= 0.0 && probe.falloff.is_finite();
    is_valid.then(|| ProbeSource {
        data: GpuLightProbe {
            probe_from_world,
            falloff: probe.falloff.to_array(),
            intensity,
            parallax_bounds: bounds.unwrap_or_default().to_array(),
            has_parallax: u32::from(bounds.is_some()),
        },
        images,
    })
}

/// Keeps the probes nearest to a camera if there are too many.
fn keep_nearest(probes: Vec<(Vec3A, ProbeSource)>, cameras: &[Vec3A]) -> Vec<ProbeSource> {
    let mut probes = probes;
    if probes.len() > MAX_PROBES {
        warn_once!(
            "{} light probes of a kind in the scene: reflections show the {MAX_PROBES} nearest to a camera that reflects",
            probes.len()
        );
        let distance = |place: Vec3A| {
            let distances = cameras.iter().map(|camera| camera.distance_squared(place));
            distances.fold(f32::INFINITY, f32::min)
        };
        probes.sort_by(|(a, _), (b, _)| distance(*a).total_cmp(&distance(*b)));
        probes.truncate(MAX_PROBES);
    }
    probes.into_iter().map(|(_, probe)| probe).collect()
}

type Probes<'w, 's, L> = Query<
    'w,
    's,
    (
        &'static GlobalTransform,
        &'static LightProbe,
        &'static L,
        &'static InheritedVisibility,
        Option<&'static ParallaxCorrection>,
    ),
>;

/// The light probes of the main world.
#[derive(SystemParam)]
pub(super) struct ProbeWorld<'w, 's> {
    reflection_probes: Probes<'w, 's, EnvironmentMapLight>,
    irradiance_volumes: Probes<'w, 's, IrradianceVolume>,
    cameras: Query<'w, 's, (&'static Camera, &'static GlobalTransform), With<RayTracedReflections>>,
}

/// Extracts the probes.
pub(super) fn extract_light_probes(world: &ProbeWorld, active: bool, mut extracted: ResMut<ExtractedLightProbes>) {
    let ProbeWorld {
        reflection_probes,
        irradiance_volumes,
        cameras,
    } = world;
    let mut current = ExtractedLightProbes::default();
    if active && !(reflection_probes.is_empty() && irradiance_volumes.is_empty()) {
        let cameras = cameras.iter().filter(|(camera, _)| camera.is_active);
        let cameras: Vec<_> = cameras.map(|(_, place)| place.translation_vec3a()).collect();
        let found = reflection_probes.iter().filter(|(.., visibility, _)| visibility.get());
        let found = found.filter_map(|(transform, light_probe, light, _, parallax)| {
            // Like in Bevy, a probe rotates with its maps.
            let place = transform.affine() * Affine3A::from_quat(light.rotation);
            let images = [light.diffuse_map.id(), light.specular_map.id()];
            let source = probe(place, light_probe, light.intensity, parallax, images)?;
            Some((place.translation, source))
        });
        current.reflection_probes = keep_nearest(found.collect(), &cameras);
        let found = irradiance_volumes.iter().filter(|(.., visibility, _)| visibility.get());
        let found = found.filter_map(|(transform, light_probe, light, ..)| {
            let images = [light.voxels.id(); 2];
            let source = probe(transform.affine(), light_probe, light.intensity, None, images)?;
            Some((transform.translation_vec3a(), source))
        });
        current.irradiance_volumes = keep_nearest(found.collect(), &cameras);
    }
    extracted.set_if_neq(current);
}

const _: () = assert!(2 * MAX_PROBES <= u32::BITS as usize);

/// The probes with usable images, in the shaders' layout.
pub(super) struct LightProbes {
    buffer: StorageSlice<GpuLightProbe>,
    data: Vec<GpuLightProbe>,
    /// Diffuse and specular map of each reflection probe in turn.
    maps: Vec<TextureView>,
    /// Voxels of each irradiance volume.
    volumes: Vec<TextureView>,
    /// Black textures that fill the arrays; `None` if the device has no binding arrays.
    fillers: Option<[TextureView; 2]>,
    marks: Marks,
    generation: u64,
}

/// Textures for bindings 11 and 12 of group 1.
pub(super) struct ProbeTextures<'a> {
    pub maps: Vec<&'a WgpuTextureView>,
    pub volumes: Vec<&'a WgpuTextureView>,
}

/// Number of storage buffers, including the probes, in the pass with the most of them (`device/support.rs`).
const STORAGE_BUFFERS: u32 = 10;

/// Layouts of bindings 11 and 12 of group 1. Without binding arrays, Bevy applies no reflection probes, either.
pub(super) fn texture_layouts(
    mode: ReflectionTextureMode,
    device: &RenderDevice,
) -> Option<[BindGroupLayoutEntryBuilder; 2]> {
    if device.limits().max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
        return None;
    }
    let float = TextureSampleType::Float { filterable: true };
    let count = |count: usize| NonZero::new(count as u32);
    match mode {
        ReflectionTextureMode::Bindless { .. } => Some([
            texture_cube(float).count(count(2 * MAX_PROBES)?),
            texture_3d(float).count(count(MAX_PROBES)?),
        ]),
        ReflectionTextureMode::Layers { .. } => None,
    }
}

fn black(dimension: TextureDimension, device: &RenderDevice, queue: &RenderQueue) -> TextureView {
    let (layers, view) = match dimension {
        TextureDimension::D2 => (6, TextureViewDimension::Cube),
        _ => (1, TextureViewDimension::D3),
    };
    let texture = device.create_texture_with_data(
        queue,
        &TextureDescriptor {
            label: Some("glint_no_light_probe"),
            size: Extent3d {
                depth_or_array_layers: layers,
                ..Default::default()
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension,
            format: TextureFormat::Rgba8Unorm,
            usage: TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::default(),
        &vec![0; 4 * layers as usize],
    );
    texture.create_view(&TextureViewDescriptor {
        dimension: Some(view),
        ..Default::default()
    })
}

/// The view of an image, if it can be bound as one of this dimension.
fn view_of(image: &GpuImage, dimension: TextureViewDimension, device: &RenderDevice) -> Option<TextureView> {
    let own = image.texture_view_descriptor.as_ref().and_then(|view| view.dimension);
    let is_volume = own.is_none() && image.texture_descriptor.dimension == TextureDimension::D3;
    let own = own.or(is_volume.then_some(TextureViewDimension::D3));
    let kind = image.view_format().sample_type(None, Some(device.features()));
    let can_be_bound = own == Some(dimension)
        && image.texture_descriptor.usage.contains(TextureUsages::TEXTURE_BINDING)
        && kind == Some(TextureSampleType::Float { filterable: true });
    can_be_bound.then(|| image.texture_view.clone())
}

impl LightProbes {
    pub fn new(mode: ReflectionTextureMode, device: &RenderDevice, queue: &RenderQueue) -> Self {
        let dimensions = [TextureDimension::D2, TextureDimension::D3];
        Self {
            buffer: StorageSlice::new(device, "glint_light_probes"),
            data: Vec::new(),
            maps: Vec::new(),
            volumes: Vec::new(),
            fillers: texture_layouts(mode, device).map(|_| dimensions.map(|dimension| black(dimension, device, queue))),
            marks: Marks::default(),
            generation: 0,
        }
    }

    /// Removes all probes.
    pub fn clear(&mut self) {
        self.data.clear();
        self.maps.clear();
        self.volumes.clear();
        self.marks = Marks::default();
        self.generation += 1;
    }

    /// Returns whether there are no probes.
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// For `SceneCounts::reflection_probe_count`.
    pub fn reflection_probe_count(&self) -> u32 {
        self.maps.len() as u32 / 2
    }

    /// For `SceneCounts::irradiance_volume_count`.
    pub fn irradiance_volume_count(&self) -> u32 {
        self.volumes.len() as u32
    }

    /// For `SceneCounts::restless_probes`.
    pub fn restless(&self) -> u32 {
        self.marks.bits()
    }

    /// For binding 10 of group 1.
    pub fn buffer(&self) -> &Buffer {
        self.buffer.buffer()
    }

    /// Changes whenever the bind group has to be rebuilt.
    pub fn generation(&self) -> u64 {
        self.generation + self.buffer.generation()
    }

    /// Returns `None` if the device has no binding arrays.
    pub fn textures(&self) -> Option<ProbeTextures<'_>> {
        let [cube, volume] = self.fillers.as_ref()?;
        // Shaders clamp indices to the whole array, so all of it is filled.
        Some(ProbeTextures {
            maps: filled(&self.maps, cube, 2 * MAX_PROBES),
            volumes: filled(&self.volumes, volume, MAX_PROBES),
        })
    }

    /// Updates the probes to the extracted ones with loaded images. Returns the kind of change for rays.
    pub fn update(
        &mut self,
        extracted: &ExtractedLightProbes,
        images: &RenderAssets<GpuImage>,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) -> Change {
        if self.fillers.is_none() || (self.is_empty() && *extracted == ExtractedLightProbes::default()) {
            return Change::Nothing;
        }
        let view = |image, dimension| view_of(images.get(image)?, dimension, device);
        let (mut data, mut maps, mut volumes) = (Vec::new(), Vec::new(), Vec::new());
        for probe in &extracted.reflection_probes {
            let [diffuse, specular] = probe.images.map(|image| view(image, TextureViewDimension::Cube));
            if let (Some(diffuse), Some(specular)) = (diffuse, specular) {
                data.push(probe.data);
                maps.extend([diffuse, specular]);
            }
        }
        for probe in &extracted.irradiance_volumes {
            if let Some(voxels) = view(probe.images[0], TextureViewDimension::D3) {
                data.push(probe.data);
                volumes.push(voxels);
            }
        }
        let ids = |views: &[TextureView]| views.iter().map(|view| view.id()).collect::<Vec<_>>();
        let (map_ids, volume_ids) = (ids(&maps), ids(&volumes));
        if (&map_ids, &volume_ids) != (&ids(&self.maps), &ids(&self.volumes)) {
            (self.maps, self.volumes) = (maps, volumes);
            self.generation += 1;
        }
        if self.buffer.may_ask_again() || self.data != data {
            self.data = data;
            self.buffer.write(&self.data, 0..self.data.len(), device, queue);
        }
        let of_maps = map_ids.chunks_exact(2).map(|pair| [pair[0], pair[1]]);
        let images = of_maps.chain(volume_ids.iter().map(|voxels| [*voxels; 2]));
        let probes = self.data.iter().copied().zip(images).collect();
        self.marks.follow(map_ids.len() / 2, probes)
    }
}

fn filled<'a>(views: &'a [TextureView], filler: &'a TextureView, count: usize) -> Vec<&'a WgpuTextureView> {
    let rest = count.saturating_sub(views.len());
    let all = views.iter().chain(core::iter::repeat_n(filler, rest));
    all.map(|view| &**view).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(place: Affine3A, intensity: f32, parallax: Option<&ParallaxCorrection>) -> Option<ProbeSource> {
        probe(
            place,
            &LightProbe::default(),
            intensity,
            parallax,
            [AssetId::default(); 2],
        )
    }

    #[test]
    fn probes_that_nothing_can_be_told_of_are_left_out() {
        let place = Affine3A::from_scale(Vec3::new(2.0, 4.0, 8.0));
        assert!(source(place, 1.0, None).is_some());
        for intensity in [f32::NAN, f32::INFINITY, -1.0] {
            assert_eq!(source(place, intensity, None), None, "{intensity}");
        }
        assert_eq!(source(Affine3A::from_scale(Vec3::ZERO), 1.0, None), None);
        let falloff = LightProbe {
            falloff: Vec3::splat(f32::NAN),
        };
        assert_eq!(probe(place, &falloff, 1.0, None, [AssetId::default(); 2]), None);
    }

    /// A probe that no active camera is near isn't among the nearest.
    #[test]
    fn inactive_cameras_choose_no_probes() {
        let mut world = World::new();
        world.init_resource::<ExtractedLightProbes>();
        let mut spawn_probe = |x: f32| {
            let place = GlobalTransform::from_xyz(x, 0.0, 0.0);
            let light = EnvironmentMapLight {
                intensity: x,
                ..Default::default()
            };
            world.spawn((place, LightProbe::default(), light, InheritedVisibility::VISIBLE));
        };
        (0..MAX_PROBES).for_each(|index| spawn_probe(index as f32));
        spawn_probe(1_000.0);
        let mut spawn_camera = |x: f32, is_active: bool| {
            let camera = Camera {
                is_active,
                ..Default::default()
            };
            let place = GlobalTransform::from_xyz(x, 0.0, 0.0);
            world.spawn((camera, place, RayTracedReflections::default())).id()
        };
        spawn_camera(0.0, true);
        let other = spawn_camera(1_000.0, false);
        for is_active in [false, true] {
            world.get_mut::<Camera>(other).unwrap().is_active = is_active;
            let extract = |probes: ProbeWorld, extracted: ResMut<ExtractedLightProbes>| {
                extract_light_probes(&probes, true, extracted);
            };
            world.run_system_cached(extract).unwrap();
            let kept = &world.resource::<ExtractedLightProbes>().reflection_probes;
            assert_eq!(kept.len(), MAX_PROBES);
            assert_eq!(kept.iter().any(|probe| probe.data.intensity == 1_000.0), is_active);
        }
    }

    #[test]
    fn points_come_into_the_space_of_a_probe() {
        let place = Affine3A::from_scale_rotation_translation(Vec3::new(2.0, 4.0, 8.0), Default::default(), Vec3::X);
        let rows = source(place, 1.0, None).unwrap().data.probe_from_world;
        let corner = [2.0, 2.0, 4.0, 1.0];
        let inside = rows.map(|row| row.iter().zip(corner).map(|(a, b)| a * b).sum::<f32>());
        assert_eq!(inside, [0.5; 3]);
    }

    #[test]
    fn parallax_is_that_of_bevy() {
        let bounds = |parallax: Option<ParallaxCorrection>| {
            let data = source(Affine3A::IDENTITY, 1.0, parallax.as_ref()).unwrap().data;
            (data.has_parallax, data.parallax_bounds)
        };
        assert_eq!(bounds(Some(ParallaxCorrection::Auto)), (1, [0.5; 3]));
        assert_eq!(bounds(Some(ParallaxCorrection::Custom(Vec3::ONE))), (1, [1.0; 3]));
        assert_eq!(bounds(Some(ParallaxCorrection::Custom(Vec3::NAN))), (0, [0.0; 3]));
        assert_eq!(bounds(Some(ParallaxCorrection::None)), (0, [0.0; 3]));
        assert_eq!(bounds(None), (0, [0.0; 3]));
    }

    #[test]
    fn the_nearest_probes_are_kept() {
        let probes = |count: usize| -> Vec<(Vec3A, ProbeSource)> {
            let probe = |i: usize| {
                let place = Affine3A::from_translation(Vec3::X * i as f32);
                Some((place.translation, source(place, i as f32, None)?))
            };
            (0..count).rev().filter_map(probe).collect()
        };
        let kept = |count, cameras: &[Vec3A]| -> Vec<f32> {
            let kept = keep_nearest(probes(count), cameras);
            kept.iter().map(|probe| probe.data.intensity).collect()
        };
        assert_eq!(kept(2, &[Vec3A::ZERO]), [1.0, 0.0], "few keep their order");
        let nearest: Vec<f32> = (0..MAX_PROBES).map(|i| i as f32).collect();
        assert_eq!(kept(40, &[Vec3A::ZERO]), nearest);
        let mut both = kept(40, &[Vec3A::ZERO, Vec3A::X * 39.0]);
        both.sort_by(f32::total_cmp);
        assert_eq!((both[0], both[7], both[8], both[15]), (0.0, 7.0, 32.0, 39.0));
    }
}
