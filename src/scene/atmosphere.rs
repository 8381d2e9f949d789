//! Bevy's atmosphere for rays: air attenuates sunlight, and rays that miss see the sky. `atmosphere.wesl` is the GPU side.

use bevy::{
    math::{Mat4, Vec3, Vec3A},
    pbr::{AtmosphereMode, ExtractedAtmosphere, GpuAtmosphereSettings},
};
use bytemuck::{Pod, Zeroable};

/// `Air` of `atmosphere.wesl`: the atmosphere around a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuAir {
    /// Rows of the 3x4 matrix from the world to metres from the planet's centre.
    pub air_from_world: [[f32; 4]; 3],
    /// Rows of the rotation from the world to the sky-view table. Its second axis points up at the viewer's position.
    pub sky_from_world: [[f32; 4]; 3],
    /// Radius of the planet in metres; 0 without an atmosphere.
    pub inner_radius: f32,
    /// Radius at which the atmosphere ends.
    pub outer_radius: f32,
    /// Distance of the viewer from the centre.
    pub viewer_radius: f32,
    /// Pads the struct to a multiple of 16 bytes.
    pub unused: f32,
}

const _: () = assert!(size_of::<GpuAir>() == 112);

/// Bevy raises every point to at least this height above the ground, in metres.
const LEAST_HEIGHT: f32 = 1.0;

impl GpuAir {
    /// The atmosphere for a viewer; `None` if its parameters are invalid.
    pub fn new(atmosphere: &ExtractedAtmosphere, viewer: Vec3) -> Option<Self> {
        let air_from_world = atmosphere.world_to_atmosphere;
        let place = Vec3A::from(air_from_world.transform_point3(viewer));
        let [right, up, back] = axes(place);
        let (inner_radius, outer_radius) = (atmosphere.inner_radius, atmosphere.outer_radius);
        let viewer_radius = place.length().max(inner_radius + LEAST_HEIGHT);
        let makes_sense =
            air_from_world.is_finite() && place.is_finite() && inner_radius > 0.0 && outer_radius > inner_radius;
        makes_sense.then(|| Self {
            air_from_world: rows(air_from_world),
            sky_from_world: [right, up, back].map(|axis| axis.extend(0.0).to_array()),
            inner_radius,
            outer_radius,
            viewer_radius,
            unused: 0.0,
        })
    }
}

/// How Bevy adds the haze of an atmosphere to a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AerialView {
    /// Metres that the aerial-view table covers; 0 if Bevy marches along each ray instead.
    pub distance: f32,
    /// Layers of that table.
    pub layers: u32,
    /// Samples along a ray: per layer of the table, or in total.
    pub samples: u32,
}

impl AerialView {
    /// The view's settings; `None` if they produce no haze.
    pub fn new(settings: &GpuAtmosphereSettings) -> Option<Self> {
        let marched = Self {
            distance: 0.0,
            layers: 1,
            samples: settings.sky_max_samples,
        };
        let looked_up = Self {
            distance: settings.aerial_view_lut_max_distance,
            layers: settings.aerial_view_lut_size.z,
            samples: settings.aerial_view_lut_samples,
        };
        if settings.rendering_method == AtmosphereMode::Raymarched as u32 {
            Some(marched).filter(|view| view.samples > 0)
        } else {
            let reaches = looked_up.distance.is_finite() && looked_up.distance > 0.0;
            Some(looked_up).filter(|view| reaches && view.layers > 0 && view.samples > 0)
        }
    }
}

fn rows(matrix: Mat4) -> [[f32; 4]; 3] {
    [0, 1, 2].map(|row| matrix.row(row).to_array())
}

/// Axes of the sky-view table, as in Bevy's `prepare_atmosphere_transforms`: up is the planet's normal at the viewer.
fn axes(place: Vec3A) -> [Vec3A; 3] {
    let up = place.try_normalize().unwrap_or(Vec3A::Y);
    let level = |axis: Vec3A| (axis - up * up.dot(axis)).try_normalize();
    let back = level(Vec3A::NEG_Z).or_else(|| level(Vec3A::NEG_Y)).unwrap_or(Vec3A::Z);
    [up.cross(back).normalize_or(Vec3A::X), up, back]
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::{asset::AssetId, pbr::AtmosphereSettings};

    fn earth(world_to_atmosphere: Mat4) -> ExtractedAtmosphere {
        ExtractedAtmosphere {
            inner_radius: 6_360_000.0,
            outer_radius: 6_460_000.0,
            ground_albedo: Vec3::ZERO,
            medium: AssetId::default(),
            world_to_atmosphere,
        }
    }

    #[test]
    fn viewers_stand_on_the_planet() {
        let below = Mat4::from_translation(Vec3::Y * 6_360_000.0);
        let air = GpuAir::new(&earth(below), Vec3::new(5.0, 100.0, 0.0)).unwrap();
        assert_eq!((air.viewer_radius, air.inner_radius), (6_360_100.0, 6_360_000.0));
        assert!(air.sky_from_world[1][1] > 0.999_999);
        let in_the_ground = GpuAir::new(&earth(below), Vec3::NEG_Y * 50.0).unwrap();
        assert_eq!(in_the_ground.viewer_radius, 6_360_001.0);
    }

    #[test]
    fn axes_are_at_right_angles_wherever_the_viewer_is() {
        for place in [
            Vec3A::ZERO,
            Vec3A::Z * 7e6,
            Vec3A::NEG_Z * 7e6,
            Vec3A::new(1.0, -2.0, 3.0) * 1e6,
        ] {
            let [x, y, z] = axes(place);
            for (a, b) in [(x, y), (y, z), (z, x)] {
                assert!(a.dot(b).abs() < 1e-5 && (a.length() - 1.0).abs() < 1e-5, "{place}");
            }
            assert!(x.cross(y).dot(z) > 0.999);
        }
    }

    #[test]
    fn haze_follows_the_settings_of_the_view() {
        let haze = |settings: AtmosphereSettings| AerialView::new(&settings.into());
        let default = AtmosphereSettings::default;
        let looked_up = AerialView {
            distance: 32_000.0,
            layers: 32,
            samples: 10,
        };
        assert_eq!(haze(default()), Some(looked_up));
        let rendering_method = AtmosphereMode::Raymarched;
        let marched = AtmosphereSettings {
            rendering_method,
            sky_max_samples: 24,
            ..default()
        };
        assert_eq!(
            haze(marched.clone()).map(|view| (view.distance, view.samples)),
            Some((0.0, 24))
        );
        let nothing = [
            AtmosphereSettings {
                sky_max_samples: 0,
                ..marched
            },
            AtmosphereSettings {
                aerial_view_lut_max_distance: f32::NAN,
                ..default()
            },
            AtmosphereSettings {
                aerial_view_lut_samples: 0,
                ..default()
            },
        ];
        assert!(nothing.into_iter().all(|settings| haze(settings).is_none()));
    }

    #[test]
    fn nonsense_is_no_atmosphere() {
        let nothing = Mat4::from_scale(Vec3::ZERO).inverse();
        assert_eq!(GpuAir::new(&earth(nothing), Vec3::ZERO), None);
        let hollow = ExtractedAtmosphere {
            outer_radius: 1.0,
            ..earth(Mat4::IDENTITY)
        };
        assert_eq!(GpuAir::new(&hollow, Vec3::ZERO), None);
        assert_eq!(GpuAir::new(&earth(Mat4::IDENTITY), Vec3::NAN), None);
    }
}
