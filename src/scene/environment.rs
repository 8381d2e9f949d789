//! Surroundings of each view: exposure, ambient light, environment map, skybox and background. They are bind group 2 of the
//! passes that shade hits. `environment.wesl` is the GPU side.

mod bindings;

use super::{
    atmosphere::{AerialView, GpuAir},
    fog_volumes::{FogWorld, GpuFogVolume, MAX_FOG_LAMPS, MAX_FOG_VOLUMES},
    gpu_types::GpuLight,
    render_layers::SceneLayers,
};
use crate::settings::{ClampedSettings, RayTracedReflections, ReflectedLayers};
use bevy::{
    asset::AssetId,
    camera::{Camera, ClearColor, ClearColorConfig, Exposure, visibility::RenderLayers},
    color::{Color, LinearRgba},
    ecs::prelude::*,
    image::Image,
    light::{
        AmbientLight, EnvironmentMapLight, GlobalAmbientLight, Skybox, VolumetricFog, atmosphere::ScatteringMedium,
    },
    math::{Quat, Vec3},
    pbr::{ExtractedAtmosphere, GpuAtmosphereSettings},
    render::{settings::WgpuFeatures, sync_world::RenderEntity},
    transform::components::GlobalTransform,
};
use bytemuck::{Pod, Zeroable};

pub(crate) use bindings::EnvironmentId;
#[cfg(test)]
pub use bindings::layout_in_browsers;
pub use bindings::{EnvironmentBindings, layout_descriptor, prepare_environments};

/// Whether there are bindings for fog density textures and for the medium of an atmosphere. Browsers allow 16 textures in a pass, which
/// some passes use up without them.
pub(super) const MANY_TEXTURES: bool = !cfg!(target_arch = "wasm32");

/// Returns whether a device supports haze: it filters Bevy's tables of the medium, which have 32-bit floats.
pub(super) fn can_have_haze(features: WgpuFeatures) -> bool {
    MANY_TEXTURES && features.contains(WgpuFeatures::FLOAT32_FILTERABLE)
}

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
    /// Linear clear colour, already exposed.
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
    /// The atmosphere around the viewer; zeros without one.
    pub air: GpuAir,
    /// Fog volumes that the camera draws.
    pub fog_volumes: [GpuFogVolume; MAX_FOG_VOLUMES],
    /// Linear colour times intensity of the ambient light in these volumes, already exposed.
    pub fog_ambient: [f32; 3],
    /// Number of fog volumes, which come first in the array.
    pub fog_volume_count: u32,
    /// Point and spot lights that shine into these volumes.
    pub fog_lamps: [GpuLight; MAX_FOG_LAMPS],
    /// Number of these lights, which come first in the array.
    pub fog_lamp_count: u32,
    /// [`AerialView::distance`].
    pub aerial_distance: f32,
    /// [`AerialView::layers`].
    pub aerial_layers: u32,
    /// [`AerialView::samples`]; 0 without haze.
    pub aerial_samples: u32,
}

const _: () = assert!(size_of::<GpuEnvironment>() == 1120);

/// A view's environment in the render world, before its images are looked up.
#[derive(Component, Clone, Debug, PartialEq)]
pub struct ViewEnvironment {
    uniform: GpuEnvironment,
    /// Diffuse and specular cube map.
    maps: Option<(AssetId<Image>, AssetId<Image>)>,
    skybox: Option<AssetId<Image>>,
    /// The density texture of the fog volumes.
    fog_density: Option<AssetId<Image>>,
    /// The medium of the atmosphere, if it causes haze.
    medium: Option<AssetId<ScatteringMedium>>,
    /// Further inputs of Bevy's atmosphere tables: the ground's colour, and the numbers of samples.
    air_tables: Option<(Vec3, [u32; 4])>,
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
    /// Returns whether the sky or the light on rough surfaces comes from this image.
    pub(super) fn shows(&self, image: AssetId<Image>) -> bool {
        let maps = self.maps.map(|(diffuse, specular)| [diffuse, specular]);
        self.skybox == Some(image) || self.fog_density == Some(image) || maps.is_some_and(|maps| maps.contains(&image))
    }

    /// Returns whether the view is in an atmosphere.
    pub(super) fn has_air(&self) -> bool {
        self.uniform.air != GpuAir::default()
    }

    /// Returns whether the atmosphere adds haze in front of the surfaces that rays hit.
    pub(super) fn has_haze(&self, features: WgpuFeatures) -> bool {
        self.medium.is_some() && can_have_haze(features)
    }

    /// Returns whether the view has fog volumes with a density texture.
    pub(super) fn has_fog_density(&self) -> bool {
        self.fog_density.is_some()
    }

    /// Returns whether the view has fog volumes.
    pub(super) fn has_fog_volumes(&self) -> bool {
        self.uniform.fog_volume_count > 0
    }

    /// Gathers the environment of a camera. `background` is its clear colour, and `ambient` its ambient colour with brightness.
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
            fog_density: None,
            medium: None,
            air_tables: None,
        }
    }

    /// Surrounds the viewer with an atmosphere.
    fn breathe(&mut self, atmosphere: &ExtractedAtmosphere, settings: &GpuAtmosphereSettings, viewer: Vec3) {
        let Some(air) = GpuAir::new(atmosphere, viewer) else {
            return;
        };
        self.uniform.air = air;
        let samples = [
            settings.transmittance_lut_samples,
            settings.multiscattering_lut_dirs,
            settings.multiscattering_lut_samples,
            settings.sky_view_lut_samples,
        ];
        self.air_tables = Some((atmosphere.ground_albedo, samples));
        if let Some(haze) = AerialView::new(settings).filter(|_| MANY_TEXTURES) {
            self.medium = Some(atmosphere.medium);
            self.uniform.aerial_distance = haze.distance;
            self.uniform.aerial_layers = haze.layers;
            self.uniform.aerial_samples = haze.samples;
        }
    }
}

/// Reflecting cameras, with the components of their environment.
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
        Option<&'static VolumetricFog>,
        &'static GlobalTransform,
    ),
>;

/// Bevy's atmospheres, by view.
pub(super) type Atmospheres<'w, 's> = Query<'w, 's, (&'static ExtractedAtmosphere, &'static GpuAtmosphereSettings)>;

/// Updates the [`ViewEnvironment`] of every reflecting view, and removes it from other views. `scene_layers` are the layers of this frame.
pub(super) fn follow_environments(
    cameras: &ReflectingCameras,
    ambient: Option<&GlobalAmbientLight>,
    clear_color: Option<&ClearColor>,
    scene_layers: &SceneLayers,
    atmospheres: &Atmospheres,
    fog_world: &FogWorld,
    views: &mut Query<(Entity, &mut ViewEnvironment)>,
    commands: &mut Commands,
) {
    let mut known = 0;
    for (entity, settings, camera, exposure, own_ambient, map, skybox, drawn, reflected, fog, place) in cameras {
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
        // Bevy extracts atmospheres in the same schedule, so this is the atmosphere of the last frame.
        if let Ok((atmosphere, settings)) = atmospheres.get(entity) {
            environment.breathe(atmosphere, settings, place.translation());
        }
        if let Some(fog) = fog {
            let uniform = &mut environment.uniform;
            uniform.fog_ambient = rgb(fog.ambient_color).map(|channel| finite(channel * finite(fog.ambient_intensity)));
            (uniform.fog_volumes, uniform.fog_volume_count) = fog_world.nearest_volumes(place.translation());
            if uniform.fog_volume_count > 0 {
                (uniform.fog_lamps, uniform.fog_lamp_count) =
                    fog_world.nearest_lamps(place.translation(), scene_layers);
                let is_textured = uniform.fog_volumes.iter().any(|volume| volume.textured != 0);
                environment.fog_density = fog_world
                    .density_texture(place.translation())
                    .filter(|_| is_textured && MANY_TEXTURES);
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{math::Mat4, pbr::AtmosphereSettings};

    #[test]
    fn haze_is_known_in_an_atmosphere_and_where_its_tables_can_be_filtered() {
        let settings = ClampedSettings::from(&RayTracedReflections::default());
        let mut view = ViewEnvironment::new(&settings, 1.0, (Color::BLACK, 0.0), None, None, None);
        let able = WgpuFeatures::FLOAT32_FILTERABLE;
        assert!(!view.has_haze(able) && !view.has_air());
        let earth = ExtractedAtmosphere {
            inner_radius: 6_360_000.0,
            outer_radius: 6_460_000.0,
            ground_albedo: Vec3::ZERO,
            medium: AssetId::default(),
            world_to_atmosphere: Mat4::from_translation(Vec3::Y * 6_360_000.0),
        };
        view.breathe(&earth, &AtmosphereSettings::default().into(), Vec3::ZERO);
        assert!(view.has_air() && view.has_haze(able) && view.has_haze(able | WgpuFeatures::TIMESTAMP_QUERY));
        assert!(!view.has_haze(WgpuFeatures::empty()) && !view.has_haze(WgpuFeatures::TIMESTAMP_QUERY));
    }
}
