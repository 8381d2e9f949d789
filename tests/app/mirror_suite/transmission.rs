//! Rows of the mirror suite about light that comes through surfaces (`StandardMaterial::diffuse_transmission`).

use super::{Row, Stage, blue};
use bevy::{
    light::{NotShadowCaster, TransmittedShadowReceiver},
    prelude::*,
};

/// Direction of light from behind the spawned objects. It grazes the mirror, which reflects almost none of it.
const FROM_BEHIND: Vec3 = Vec3::new(-1.0, -0.5, -0.15);

pub(super) const ROWS: [Row; 4] = [
    ("light through surfaces", |stage| {
        stage.light_from_behind();
        stage.spawn(leaf());
    }),
    ("ambient light and an environment through surfaces", |stage| {
        stage.dress(AmbientLight {
            brightness: 300.0,
            ..default()
        });
        stage.surround();
        stage.spawn(StandardMaterial {
            diffuse_transmission: 1.0,
            ..leaf()
        });
    }),
    ("a rectangular light through surfaces", |stage| {
        stage.add((
            RectLight {
                intensity: 150_000.0,
                // Less than to the mirror.
                range: 8.0,
                width: 2.0,
                height: 1.0,
                ..default()
            },
            Transform::from_xyz(0.8, 1.6, 10.6).looking_to(Vec3::new(-0.2, -0.3, -1.0), Vec3::Y),
        ));
        stage.spawn(leaf());
    }),
    ("shadows on light through a surface", |stage| {
        stage.add((
            PointLight {
                intensity: 150_000.0,
                // Less than to the mirror.
                range: 8.0,
                shadow_maps_enabled: true,
                ..default()
            },
            Transform::from_xyz(0.6, 0.9, 9.2),
        ));
        stage.spawn(blue());
        stage.hang_sheet();
    }),
];

/// It transmits the light behind a thickness of 0.3 m.
fn leaf() -> StandardMaterial {
    StandardMaterial {
        base_color: Color::linear_rgb(0.3, 0.8, 0.2),
        diffuse_transmission: 0.7,
        thickness: 0.3,
        ..blue()
    }
}

impl Stage<'_> {
    /// The sun behind the spawned objects, and a lamp.
    fn light_from_behind(&mut self) {
        self.add_sun(2000.0, false, FROM_BEHIND, ());
        self.add((
            PointLight {
                color: Color::linear_rgb(1.0, 0.6, 0.3),
                intensity: 100_000.0,
                range: 9.0,
                radius: 0.1,
                ..default()
            },
            Transform::from_xyz(0.4, 0.7, 10.6),
        ));
    }

    /// A thin sheet in front of the spawned objects, which casts shadows on their backs.
    fn hang_sheet(&mut self) {
        let material = StandardMaterial {
            thickness: 0.02,
            ..leaf()
        };
        let at = Transform::from_xyz(-0.4, 0.2, 5.3).looking_to(Vec3::Z, Vec3::Y);
        let sheet = self.put(Rectangle::new(2.4, 1.8), material, at);
        let shadows = (NotShadowCaster, TransmittedShadowReceiver);
        self.app.world().entity_mut(sheet).insert(shadows);
    }
}
