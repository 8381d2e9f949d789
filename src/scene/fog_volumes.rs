//! Volumes of fog (`FogVolume`) for rays, and lights that shine into them (`VolumetricLight`): the ones nearest to each camera that
//! draws fog. The GPU side is `trace/volumes.wesl`, and `trace/fog_density.wesl` for density textures.

use super::{
    gpu_types::{GpuLight, LIGHT_CASTS_SHADOW},
    pack_lights::{non_negative, point_light, spot_light},
    render_layers::SceneLayers,
};
use bevy::{
    asset::{AssetId, Handle},
    camera::visibility::{InheritedVisibility, RenderLayers},
    color::ColorToComponents,
    ecs::{prelude::*, system::SystemParam},
    image::Image,
    light::{FogVolume, PointLight, SpotLight, VolumetricLight},
    log::warn_once,
    math::{Vec3, Vec3A},
    transform::components::GlobalTransform,
};
use bytemuck::{Pod, Zeroable};

/// Maximum number of volumes per camera; `environment.wesl` has the same number.
pub const MAX_FOG_VOLUMES: usize = 4;
/// Maximum number of lights in fog per camera; `environment.wesl` has the same number.
pub const MAX_FOG_LAMPS: usize = 8;

/// `FogVolume` of `environment.wesl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuFogVolume {
    /// Rows of the 3x4 matrix into a space in which the volume extends from -0.5 to 0.5.
    pub volume_from_world: [[f32; 4]; 3],
    /// Scattering coefficient per metre over all directions, times colour.
    pub scattered: [f32; 3],
    /// Extinction coefficient per metre.
    pub extinction: f32,
    /// Asymmetry of the Henyey-Greenstein phase function: -1 (back to the light) to 1 (away from it).
    pub asymmetry: f32,
    /// Extinction coefficient of ambient light per metre: here, Bevy assumes a density of 1.
    pub ambient_extinction: f32,
    /// Radius of the sphere by which Bevy approximates the volume, in metres.
    pub radius: f32,
    /// 1 if the view's texture scales the density.
    pub textured: u32,
    /// Offset into that texture, in its own coordinates.
    pub texture_offset: [f32; 3],
    /// Pads the struct to a multiple of 16 bytes.
    pub unused: f32,
}

const _: () = assert!(size_of::<GpuFogVolume>() == 96);

/// The nearest items, and their number.
pub type Nearest<T, const MOST: usize> = ([T; MOST], u32);

/// The fog volumes of the main world.
pub type FogVolumes<'w, 's> = Query<
    'w,
    's,
    (
        &'static FogVolume,
        &'static GlobalTransform,
        &'static InheritedVisibility,
    ),
>;

/// Lights of one kind that shine into fog.
type Lamps<'w, 's, L> = Query<
    'w,
    's,
    (
        &'static L,
        &'static GlobalTransform,
        &'static InheritedVisibility,
        Option<&'static RenderLayers>,
    ),
    With<VolumetricLight>,
>;

/// Fog of the main world, and lights that shine into it.
#[derive(SystemParam)]
pub struct FogWorld<'w, 's> {
    volumes: FogVolumes<'w, 's>,
    points: Lamps<'w, 's, PointLight>,
    spots: Lamps<'w, 's, SpotLight>,
}

impl FogWorld<'_, '_> {
    /// The volumes nearest to a viewer.
    pub fn nearest_volumes(&self, viewer: Vec3) -> Nearest<GpuFogVolume, MAX_FOG_VOLUMES> {
        let texture = self.density_texture(viewer);
        let visible = self.volumes.iter().filter(|(_, _, visibility)| visibility.get());
        let known = visible.filter(|(volume, ..)| texture_of(volume).is_none_or(|own| Some(own) == texture));
        nearest(
            known.filter_map(|(volume, place, _)| Some((place.translation(), pack_fog_volume(volume, place)?))),
            viewer,
        )
    }

    /// The density texture for rays of a camera: the one of the nearest volume that has one.
    pub fn density_texture(&self, viewer: Vec3) -> Option<AssetId<Image>> {
        let visible = self.volumes.iter().filter(|(_, _, visibility)| visibility.get());
        let mut textured = visible.filter_map(|(volume, place, _)| {
            let texture = texture_of(volume)?;
            // Invisible fog is ignored.
            pack_fog_volume(volume, place)?;
            Some((place.translation().distance_squared(viewer), texture))
        });
        let mut nearest = textured.next()?;
        for other in textured {
            if other.1 != nearest.1 {
                warn_once!(
                    "volumes of fog have several density textures: reflections show only those with the texture of the nearest one, and \
                     those without any; share a texture among them"
                );
            }
            if other.0 < nearest.0 {
                nearest = other;
            }
        }
        Some(nearest.1)
    }

    /// The lights that reach a volume, nearest to a viewer first.
    pub fn nearest_lamps(&self, viewer: Vec3, layers: &SceneLayers) -> Nearest<GpuLight, MAX_FOG_LAMPS> {
        let visible = self.volumes.iter().filter(|(_, _, visibility)| visibility.get());
        let bounds: Vec<(Vec3, f32)> = visible
            .map(|(_, place, _)| (place.translation(), bounding_radius(place)))
            .collect();
        let reaches = |(place, lamp): &(Vec3, GpuLight)| {
            let range = lamp.inverse_range_squared.max(1e-20).sqrt().recip();
            let mut volumes = bounds.iter();
            volumes.any(|(center, radius)| place.distance(*center) <= range + radius)
        };
        let all = lamps(&self.points, point_light, layers).chain(lamps(&self.spots, spot_light, layers));
        nearest(all.filter(reaches), viewer)
    }
}

/// Lights of one kind that shine into fog, and their positions. In Bevy, only lights with shadow maps do.
fn lamps<L: Component>(
    lamps: &Lamps<L>,
    convert: fn(&L, &GlobalTransform) -> Option<GpuLight>,
    layers: &SceneLayers,
) -> impl Iterator<Item = (Vec3, GpuLight)> {
    lamps
        .iter()
        .filter(|(_, _, visibility, own)| visibility.get() && layers.groups_of(*own) != 0)
        .filter_map(move |(lamp, place, ..)| Some((place.translation(), convert(lamp, place)?)))
        .filter(|(_, lamp)| lamp.flags & LIGHT_CASTS_SHADOW != 0)
}

/// The items nearest to a viewer, the nearest first.
fn nearest<T: Copy + Default, const MOST: usize>(
    all: impl Iterator<Item = (Vec3, T)>,
    viewer: Vec3,
) -> Nearest<T, MOST> {
    let mut all: Vec<(f32, T)> = all
        .map(|(place, item)| (place.distance_squared(viewer), item))
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut nearest = [T::default(); MOST];
    let count = all.len().min(MOST);
    for (place, (_, item)) in nearest.iter_mut().zip(all) {
        *place = item;
    }
    (nearest, count as u32)
}

/// Radius of the sphere by which Bevy approximates a volume, in metres.
fn bounding_radius(place: &GlobalTransform) -> f32 {
    (place.affine().matrix3 * Vec3A::splat(0.5)).length()
}

fn texture_of(volume: &FogVolume) -> Option<AssetId<Image>> {
    volume.density_texture.as_ref().map(Handle::id)
}

/// Returns `None` for invisible volumes.
fn pack_fog_volume(volume: &FogVolume, place: &GlobalTransform) -> Option<GpuFogVolume> {
    let inverse = place.affine().inverse();
    let density = non_negative(volume.density_factor);
    let (absorption, scattering) = (non_negative(volume.absorption), non_negative(volume.scattering));
    let extinction = density * (absorption + scattering);
    // Bevy attenuates the light on its way into the volume as if the volume were a sphere around it.
    let radius = bounding_radius(place);
    let color = volume.fog_color.to_linear().to_vec3() * volume.light_tint.to_linear().to_vec3();
    let is_textured = volume.density_texture.is_some();
    // The attenuation varies with a texture, so the shader computes it.
    let dimmed = if is_textured { 1.0 } else { (-extinction * radius).exp() };
    let scattered = color * (non_negative(volume.light_intensity) * scattering * density * dimmed);
    let offset = volume.density_texture_offset;
    let is_seen = inverse.is_finite() && scattered.is_finite() && extinction > 0.0 && radius.is_finite();
    is_seen.then(|| GpuFogVolume {
        volume_from_world: [0, 1, 2].map(|row| {
            let axes = inverse.matrix3;
            [
                axes.x_axis[row],
                axes.y_axis[row],
                axes.z_axis[row],
                inverse.translation[row],
            ]
        }),
        scattered: scattered.max(Vec3::ZERO).to_array(),
        extinction,
        // At 1, all light would continue in its direction.
        asymmetry: if volume.scattering_asymmetry.is_finite() {
            volume.scattering_asymmetry.clamp(-0.99, 0.99)
        } else {
            0.0
        },
        ambient_extinction: absorption + scattering,
        radius,
        textured: u32::from(is_textured),
        texture_offset: if offset.is_finite() {
            offset.to_array()
        } else {
            [0.0; 3]
        },
        unused: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{asset::uuid::Uuid, ecs::system::SystemState, transform::components::Transform};

    #[test]
    fn rays_know_the_nearest_volumes_that_are_seen() {
        let mut world = World::new();
        let mut spawn = |x: f32, visibility, volume| {
            let place = Transform::from_xyz(x, 0.0, 0.0).with_scale(Vec3::splat(2.0));
            world.spawn((volume, GlobalTransform::from(place), visibility));
        };
        for x in [7.0, 3.0, 9.0, 5.0, 1.0] {
            spawn(x, InheritedVisibility::VISIBLE, FogVolume::default());
        }
        spawn(0.0, InheritedVisibility::HIDDEN, FogVolume::default());
        let clear = FogVolume {
            density_factor: f32::NAN,
            ..Default::default()
        };
        spawn(0.0, InheritedVisibility::VISIBLE, clear);
        let mut state = SystemState::<FogWorld>::new(&mut world);
        let fog = state.get(&world).expect("all parameters are there");
        let (packed, count) = fog.nearest_volumes(Vec3::ZERO);
        assert_eq!(count, 4);
        assert_eq!(
            packed.map(|volume| volume.volume_from_world[0][3]),
            [-0.5, -1.5, -2.5, -3.5]
        );
        assert!((packed[0].extinction - 0.06).abs() < 1e-6);
    }

    #[test]
    fn rays_know_the_density_texture_of_the_nearest_volume_that_has_one() {
        let mut world = World::new();
        let [near, far] = [1, 2].map(|number| Handle::Uuid(Uuid::from_u128(number), core::marker::PhantomData));
        let volumes = [
            (1.0, None),
            (5.0, Some(&far)),
            (3.0, Some(&near)),
            (9.0, Some(&near)),
            // A hidden volume, and one without any fog.
            (0.5, Some(&far)),
            (0.7, Some(&far)),
        ];
        for (x, texture) in volumes {
            let is_seen = x > 0.6;
            let volume = FogVolume {
                density_texture: texture.cloned(),
                density_texture_offset: Vec3::X * x,
                density_factor: if (0.6..1.0).contains(&x) { 0.0 } else { 0.1 },
                ..Default::default()
            };
            let visibility = if is_seen {
                InheritedVisibility::VISIBLE
            } else {
                InheritedVisibility::HIDDEN
            };
            world.spawn((volume, GlobalTransform::from_xyz(x, 0.0, 0.0), visibility));
        }
        let mut state = SystemState::<FogWorld>::new(&mut world);
        let fog = state.get(&world).expect("all parameters are there");
        assert_eq!(fog.density_texture(Vec3::ZERO), Some(near.id()));
        let (packed, count) = fog.nearest_volumes(Vec3::ZERO);
        assert_eq!(count, 3, "the one with another texture is left out");
        let known = packed.map(|volume| (volume.textured, volume.texture_offset[0]));
        assert_eq!(known[..3], [(0, 1.0), (1, 3.0), (1, 9.0)]);
        // Light is attenuated by the density at its position.
        assert!(packed[1].scattered[0] > packed[0].scattered[0]);
    }

    #[test]
    fn rays_know_the_nearest_lamps_that_shine_into_fog() {
        let mut world = World::new();
        let mut spawn = |x: f32, visibility, is_point: bool, is_volumetric: bool| {
            let mut entity = world.spawn((GlobalTransform::from_xyz(x, 0.0, 0.0), visibility));
            if is_point {
                entity.insert(PointLight {
                    shadow_maps_enabled: true,
                    ..Default::default()
                });
            } else {
                entity.insert(SpotLight {
                    shadow_maps_enabled: true,
                    ..Default::default()
                });
            }
            if is_volumetric {
                entity.insert(VolumetricLight);
            }
            entity.id()
        };
        for number in 0..12 {
            spawn(
                12.0 - number as f32,
                InheritedVisibility::VISIBLE,
                number % 2 == 0,
                true,
            );
        }
        spawn(0.5, InheritedVisibility::HIDDEN, true, true);
        spawn(0.5, InheritedVisibility::VISIBLE, true, false);
        let shadowless = spawn(0.5, InheritedVisibility::VISIBLE, true, true);
        let elsewhere = spawn(0.5, InheritedVisibility::VISIBLE, false, true);
        let out_of_reach = spawn(0.5, InheritedVisibility::VISIBLE, true, true);
        world.entity_mut(out_of_reach).insert(PointLight {
            range: 1.0,
            shadow_maps_enabled: true,
            ..Default::default()
        });
        world.spawn((
            FogVolume::default(),
            GlobalTransform::from_xyz(14.0, 0.0, 0.0),
            InheritedVisibility::VISIBLE,
        ));
        world.entity_mut(shadowless).insert(PointLight::default());
        world.entity_mut(elsewhere).insert(RenderLayers::layer(3));
        let mut layers = SceneLayers::default();
        layers.follow(core::iter::once((None, None)), core::iter::empty());
        let mut state = SystemState::<FogWorld>::new(&mut world);
        let fog = state.get(&world).expect("all parameters are there");
        let (lamps, count) = fog.nearest_lamps(Vec3::ZERO, &layers);
        assert_eq!(count, 8);
        assert!(
            (1..)
                .zip(&lamps)
                .all(|(distance, lamp)| lamp.position == [distance as f32, 0.0, 0.0])
        );
    }
}
