//! Rows of the mirror suite about haze of an atmosphere.

use super::{Row, Stage, blue};
use crate::stage::{add, behind, metal, spawn_mesh};
use bevy::{
    light::{Atmosphere, SunDisk, atmosphere::ScatteringMedium},
    material::OpaqueRendererMethod,
    pbr::{AtmosphereMode, AtmosphereSettings, ScreenSpaceTransmission},
    prelude::*,
};
use bevy_glint::ReflectionTechnique;

/// The camera that both mirrors show, mirrored twice.
pub(super) const BEHIND_BOTH: Transform = Transform::from_xyz(-19.0, 0.0, 16.0).with_rotation(Quat::from_xyzw(
    0.0,
    -core::f32::consts::FRAC_1_SQRT_2,
    0.0,
    core::f32::consts::FRAC_1_SQRT_2,
));

pub(super) const ROWS: [Row; 7] = [
    ("haze of an atmosphere", |stage| {
        stage.lie_in_haze(AtmosphereSettings::default(), 1.0);
        stage.spawn(blue());
        stage.enlarge(500.0);
    }),
    ("haze that is marched, in kilometres", |stage| {
        stage.lie_in_haze(marched(), 0.001);
        stage.spawn(blue());
    }),
    ("haze along the first of two rays", |stage| {
        stage.bounces = 2;
        stage.lie_in_haze(marched(), 0.001);
        // Bevy has no reflections in them.
        let unlit = StandardMaterial { unlit: true, ..blue() };
        stage.spawn(unlit.clone());
        stage.open();
        stage.put(Rectangle::new(60.0, 60.0), unlit, behind(12.0));
    }),
    ("haze along the second of two rays", |stage| {
        stage.bounces = 2;
        stage.lie_in_haze(marched(), 0.001);
        stage.shine_from_above();
        stage.spawn_beside();
    }),
    ("blended surfaces, which have no haze", |stage| {
        stage.technique = ReflectionTechnique::Quarter;
        stage.own_rays = true;
        stage.lie_in_haze(AtmosphereSettings::default(), 1.0);
        // Bevy would light them with the normals of the surfaces behind.
        stage.spawn(StandardMaterial {
            base_color: Color::linear_rgba(0.1, 0.3, 0.8, 0.6),
            alpha_mode: AlphaMode::Blend,
            unlit: true,
            ..blue()
        });
        stage.enlarge(500.0);
    }),
    ("glass, which has no haze", |stage| {
        stage.dress(ScreenSpaceTransmission::default());
        stage.hang_glass_in_haze();
    }),
    ("glass that is drawn as if it were opaque, in haze", |stage| {
        stage.hang_glass_in_haze();
    }),
];

/// Height of the ground of haze above the sea, in metres.
const GROUND: f32 = 1_500.0;

fn marched() -> AtmosphereSettings {
    AtmosphereSettings {
        rendering_method: AtmosphereMode::Raymarched,
        ..default()
    }
}

impl Stage<'_> {
    /// Surrounds everything with air, in which a metre is `metre` units, and lights it from the side: air on the way to the mirror is
    /// as bright as behind it.
    fn lie_in_haze(&mut self, settings: AtmosphereSettings, metre: f32) {
        let medium = ScatteringMedium::earth(64, 64);
        let atmosphere = Atmosphere::earth(add(self.app, medium));
        let depth = (atmosphere.inner_radius + GROUND) * metre;
        self.add((
            atmosphere,
            Transform::from_xyz(0.0, -depth, 0.0).with_scale(Vec3::splat(metre)),
        ));
        self.dress(settings);
        self.add_sun(6_000.0, false, Vec3::new(1.0, -0.4, 0.0), SunDisk::OFF);
    }

    /// Glass with so little transmission that nothing is visible behind it. Cameras without a pass for such glass draw it only with
    /// forward rendering.
    fn hang_glass_in_haze(&mut self) {
        self.lie_in_haze(AtmosphereSettings::default(), 1.0);
        self.spawn(StandardMaterial {
            specular_transmission: 0.001,
            opaque_render_method: OpaqueRendererMethod::Forward,
            unlit: true,
            ..blue()
        });
        self.enlarge(500.0);
    }

    /// Scales the spawned objects and their distance by this factor.
    fn enlarge(&mut self, scale: f32) {
        for entity in self.spawned.clone() {
            let mut entity = self.app.world().entity_mut(entity);
            if entity.contains::<Mesh3d>() {
                let mut at = entity.get_mut::<Transform>().unwrap();
                at.translation *= scale;
                at.scale *= scale;
            }
        }
    }

    /// Turns the sun: from above, air is as bright in all directions that rays are turned to.
    fn shine_from_above(&mut self) {
        let sun = *self.spawned.last().expect("haze has a sun");
        let down = Transform::default().looking_to(Vec3::NEG_Y, Vec3::X);
        self.app.world().entity_mut(sun).insert(down);
    }

    /// Objects to the right of a second mirror, which is behind the camera at an angle of 45 degrees. The first mirror shows them only
    /// in the second one, which is too far away to see the first one.
    fn spawn_beside(&mut self) {
        let unlit = StandardMaterial { unlit: true, ..blue() };
        let white = StandardMaterial {
            base_color: Color::WHITE,
            ..unlit.clone()
        };
        let mirror = Transform::from_xyz(0.0, 0.0, 16.0).looking_to(Vec3::new(-1.0, 0.0, 1.0), Vec3::Y);
        let mirror = spawn_mesh(self.app, Rectangle::new(100.0, 60.0), metal(0.0), mirror);
        let ball = Transform::from_xyz(17.0, 1.2, 13.6);
        let block = Transform::from_xyz(20.0, -1.5, 19.4).with_rotation(Quat::from_rotation_y(0.6));
        let back = Transform::from_xyz(28.0, 0.0, 16.0).looking_to(Vec3::X, Vec3::Y);
        let things = [
            spawn_mesh(self.app, Sphere::new(3.4), unlit.clone(), ball),
            spawn_mesh(self.app, Cuboid::from_length(5.2), unlit, block),
            spawn_mesh(self.app, Rectangle::new(80.0, 60.0), white, back),
            mirror,
        ];
        self.spawned.extend(things);
        self.second = Some(mirror);
    }
}
