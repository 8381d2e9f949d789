//! Volumes of fog (`FogVolume`) as rays see them: those that lie nearest to a camera which draws them. `trace/volumes.wesl` is the GPU side.

use bevy::{
    camera::visibility::InheritedVisibility,
    color::ColorToComponents,
    ecs::prelude::*,
    light::FogVolume,
    math::{Vec3, Vec3A},
    transform::components::GlobalTransform,
};
use bytemuck::{Pod, Zeroable};

/// Volumes that rays of a camera know; `environment.wesl` has the same number.
pub const MAX_FOG_VOLUMES: usize = 4;

/// `FogVolume` of `environment.wesl`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuFogVolume {
    /// Rows of the 3x4 matrix into a space where the volume reaches from -0.5 to 0.5.
    pub volume_from_world: [[f32; 4]; 3],
    /// Share of light that a metre scatters in all directions, times its colour.
    pub scattered: [f32; 3],
    /// Part of the light that is lost in a metre, as an exponent.
    pub extinction: f32,
    /// Asymmetry of the Henyey-Greenstein phase function: -1 (back to the light) to 1 (away from it).
    pub asymmetry: f32,
    /// Part of ambient light that is lost in a metre, as an exponent: Bevy takes the density for 1 there.
    pub ambient_extinction: f32,
    /// Brings it to a multiple of 16 bytes.
    pub unused: [f32; 2],
}

const _: () = assert!(size_of::<GpuFogVolume>() == 80);

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

/// The volumes that are nearest to a viewer, and how many they are.
pub fn nearest_fog_volumes(volumes: &FogVolumes, viewer: Vec3) -> ([GpuFogVolume; MAX_FOG_VOLUMES], u32) {
    let mut nearest: Vec<(f32, GpuFogVolume)> = volumes
        .iter()
        .filter(|(_, _, visibility)| visibility.get())
        .filter_map(|(volume, place, _)| {
            let packed = pack_fog_volume(volume, place)?;
            Some((place.translation().distance_squared(viewer), packed))
        })
        .collect();
    nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut packed = [GpuFogVolume::default(); MAX_FOG_VOLUMES];
    let count = nearest.len().min(MAX_FOG_VOLUMES);
    for (volume, (_, nearest)) in packed.iter_mut().zip(nearest) {
        *volume = nearest;
    }
    (packed, count as u32)
}

/// `None` for what can't be seen, and for fog whose density is a texture.
fn pack_fog_volume(volume: &FogVolume, place: &GlobalTransform) -> Option<GpuFogVolume> {
    let inverse = place.affine().inverse();
    let density = non_negative(volume.density_factor);
    let (absorption, scattering) = (non_negative(volume.absorption), non_negative(volume.scattering));
    let extinction = density * (absorption + scattering);
    // Bevy dims the light on its way into the volume as if that were a sphere around it.
    let radius = (place.affine().matrix3 * Vec3A::splat(0.5)).length();
    let color = volume.fog_color.to_linear().to_vec3() * volume.light_tint.to_linear().to_vec3();
    let scattered =
        color * (non_negative(volume.light_intensity) * scattering * density * (-extinction * radius).exp());
    let is_seen = inverse.is_finite() && scattered.is_finite() && extinction > 0.0 && volume.density_texture.is_none();
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
        // At 1, all light would go on in its direction.
        asymmetry: if volume.scattering_asymmetry.is_finite() {
            volume.scattering_asymmetry.clamp(-0.99, 0.99)
        } else {
            0.0
        },
        ambient_extinction: absorption + scattering,
        unused: [0.0; 2],
    })
}

fn non_negative(value: f32) -> f32 {
    if value.is_finite() { value.max(0.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{ecs::system::SystemState, transform::components::Transform};

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
        let mut state = SystemState::<FogVolumes>::new(&mut world);
        let volumes = state.get(&world).expect("all parameters are there");
        let (packed, count) = nearest_fog_volumes(&volumes, Vec3::ZERO);
        assert_eq!(count, 4);
        assert_eq!(
            packed.map(|volume| volume.volume_from_world[0][3]),
            [-0.5, -1.5, -2.5, -3.5]
        );
        assert!((packed[0].extinction - 0.06).abs() < 1e-6);
    }
}
