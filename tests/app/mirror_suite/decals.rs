//! Rows of the mirror suite about clustered decals. Bevy draws them on materials of its forward pass.

use super::{Row, Stage, blue};
use crate::stage::behind;
use bevy::{
    camera::visibility::RenderLayers, image::Image, light::ClusteredDecal, material::OpaqueRendererMethod, prelude::*,
};
use bevy_glint::ReflectionTechnique;

pub(super) const ROWS: [Row; 11] = [
    ("decals on deferred surfaces, which show none", |stage| {
        stage.light_and_spawn(blue());
        stage.paste(|decal, _| decal);
    }),
    ("decals", |stage| {
        stage.light_and_spawn(forward());
        stage.paste(|decal, _| decal);
    }),
    ("decals, by mirrors' own rays", |stage| {
        stage.own_rays = true;
        stage.light_and_spawn(forward());
        stage.paste(|decal, _| decal);
    }),
    ("decals, at rest", |stage| {
        stage.technique = ReflectionTechnique::Converged;
        stage.frames = 4;
        stage.light_and_spawn(forward());
        stage.paste(|decal, _| decal);
    }),
    ("decals with metallic and roughness", |stage| {
        stage.light_and_spawn(forward());
        let look = stage.checkers([0, 60, 240, 255], [0, 220, 20, 255], false);
        stage.paste(|decal, _| ClusteredDecal {
            metallic_roughness_texture: Some(look.clone()),
            ..decal
        });
    }),
    ("decals that glow", |stage| {
        stage.light_and_spawn(forward());
        let glow = stage.checkers([200, 120, 40, 255], [0, 0, 0, 255], true);
        stage.paste(|decal, index| ClusteredDecal {
            base_color_texture: decal.base_color_texture.filter(|_| index % 2 == 0),
            emissive_texture: Some(glow.clone()),
            ..default()
        });
    }),
    ("decals with normal maps", |stage| {
        stage.light_and_spawn(forward());
        let normals = stage.checkers([160, 128, 245, 255], [128, 90, 240, 255], false);
        stage.paste(|_, _| ClusteredDecal {
            normal_map_texture: Some(normals.clone()),
            ..default()
        });
    }),
    ("decals on unlit surfaces", |stage| {
        stage.spawn(StandardMaterial {
            unlit: true,
            ..forward()
        });
        stage.paste(|decal, _| decal);
    }),
    ("decals on lightmaps, on paths of two bounces", |stage| {
        stage.bounces = 2;
        stage.spawn(forward());
        let light = stage.checkers([255, 220, 180, 255], [60, 90, 200, 255], true);
        stage.bake(&light);
        stage.paste(|decal, _| decal);
    }),
    ("decals that are hidden, or on another layer", |stage| {
        stage.light_and_spawn(forward());
        stage.paste(|decal, _| decal);
        let world = stage.app.world();
        let pasted: Vec<Entity> = (world.query_filtered::<Entity, With<ClusteredDecal>>())
            .iter(world)
            .collect();
        world.entity_mut(pasted[0]).insert(Visibility::Hidden);
        world.entity_mut(pasted[1]).insert(RenderLayers::layer(7));
    }),
    ("two dozen decals", |stage| {
        stage.light_and_spawn(forward());
        let wall = behind(11.9);
        stage.put(Rectangle::new(20.0, 12.0), forward(), wall);
        // Few borders, none of them parallel to the pixels, and similar colours: half a pixel makes a difference.
        let colors = [[90, 120, 230, 150], [120, 180, 220, 110]];
        let [violet, green] = colors.map(|color| stage.checkers(color, color, true));
        for index in 0..24_u8 {
            let (column, line) = (f32::from(index % 6), f32::from(index / 6));
            let image = if index % 3 == 0 { &violet } else { &green };
            let decal = ClusteredDecal {
                base_color_texture: Some(image.clone()),
                ..default()
            };
            let at = Transform::from_xyz(3.1 * (column - 2.5), 3.0 * (line - 1.5), 12.0);
            let turned = at.with_rotation(Quat::from_rotation_z(0.3 * column + line + 0.2));
            stage.add((decal, turned.with_scale(Vec3::new(2.2, 2.0, 0.5))));
        }
    }),
];

fn forward() -> StandardMaterial {
    StandardMaterial {
        opaque_render_method: OpaqueRendererMethod::Forward,
        ..blue()
    }
}

impl Stage<'_> {
    /// Squares of two colours with different opacity.
    fn squares(&mut self) -> Handle<Image> {
        self.checkers([230, 60, 30, 255], [240, 220, 90, 110], true)
    }

    /// Decals on the sphere, on the cuboid and on the deferred wall. None of them overlap, because Bevy composites decals in any order.
    fn paste(&mut self, change: impl Fn(ClusteredDecal, usize) -> ClusteredDecal) {
        let image = self.squares();
        let places = [
            Transform::from_xyz(-1.2, 0.4, 6.2).with_rotation(Quat::from_euler(EulerRot::XYZ, 0.2, 2.9, 0.4)),
            Transform::from_xyz(2.0, -0.6, 8.0).with_rotation(Quat::from_rotation_y(0.5)),
            Transform::from_xyz(0.4, 1.7, 12.0).with_rotation(Quat::from_rotation_z(0.7)),
        ];
        let sizes = [
            Vec3::new(1.5, 1.3, 1.6),
            Vec3::new(1.6, 1.2, 1.5),
            Vec3::new(3.0, 2.0, 0.7),
        ];
        for (index, (place, size)) in places.into_iter().zip(sizes).enumerate() {
            let plain = ClusteredDecal {
                base_color_texture: Some(image.clone()),
                ..default()
            };
            self.add((change(plain, index), place.with_scale(size)));
        }
    }
}
