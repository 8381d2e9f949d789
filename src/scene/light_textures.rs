//! Textures of lights (`PointLightTexture`, `SpotLightTexture` and `DirectionalLightTexture`): images that dim a light by direction or
//! position. Their records follow the lights in one buffer, and `light_textures.wesl` is the GPU side.

use super::{
    bevy_shaders::lighting_defines,
    gpu_types::{GpuLight, GpuLightTexture, LIGHT_TEXTURE_SHIFT, NO_TEXTURE},
    textures::TextureTable,
};
use bevy::{
    asset::AssetId,
    ecs::{prelude::*, system::SystemParam},
    image::Image,
    light::{DirectionalLightTexture, PointLightTexture, SpotLight, SpotLightTexture},
    pbr::deferred::DeferredLightingLayout,
    platform::collections::HashSet,
    transform::components::GlobalTransform,
};
use std::f32::consts::FRAC_PI_2;

/// Shader definition with which Bevy reads textures of lights.
const DEFINITION: &str = "LIGHT_TEXTURES";

/// The texture of a light in the main world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightTexture {
    image: AssetId<Image>,
    /// Rows of the 3x4 matrix into the light's own space.
    light_from_world: [[f32; 4]; 3],
    /// As in [`GpuLightTexture`].
    projection: f32,
}

impl LightTexture {
    /// Returns `None` if the transform can't be inverted.
    fn new(image: AssetId<Image>, place: &GlobalTransform, projection: f32) -> Option<Self> {
        let inverse = place.affine().inverse();
        let axes = inverse.matrix3;
        (inverse.is_finite() && projection.is_finite()).then(|| Self {
            image,
            light_from_world: [0, 1, 2].map(|row| {
                [
                    axes.x_axis[row],
                    axes.y_axis[row],
                    axes.z_axis[row],
                    inverse.translation[row],
                ]
            }),
            projection,
        })
    }
}

/// Textures of the lights of the main world.
#[derive(SystemParam)]
pub struct LightTextureWorld<'w, 's> {
    directional: Query<'w, 's, (&'static DirectionalLightTexture, &'static GlobalTransform)>,
    points: Query<'w, 's, (&'static PointLightTexture, &'static GlobalTransform)>,
    spots: Query<'w, 's, (&'static SpotLightTexture, &'static SpotLight, &'static GlobalTransform)>,
}

impl LightTextureWorld<'_, '_> {
    /// Returns whether there are directional, point and spot lights with textures.
    pub fn kinds(&self) -> [bool; 3] {
        [
            !self.directional.is_empty(),
            !self.points.is_empty(),
            !self.spots.is_empty(),
        ]
    }

    /// The texture of a directional light.
    pub fn of_directional(&self, light: Entity) -> Option<LightTexture> {
        let (texture, place) = self.directional.get(light).ok()?;
        LightTexture::new(texture.image.id(), place, f32::from(u8::from(texture.tiled)))
    }

    /// The texture of a point light.
    pub fn of_point(&self, light: Entity) -> Option<LightTexture> {
        let (texture, place) = self.points.get(light).ok()?;
        LightTexture::new(texture.image.id(), place, texture.cubemap_layout as u32 as f32)
    }

    /// The texture of a spot light, which fills its cone.
    pub fn of_spot(&self, light: Entity) -> Option<LightTexture> {
        let (texture, spot, place) = self.spots.get(light).ok()?;
        // The minimum angle keeps quotients finite.
        let angle = spot.outer_angle.clamp(1e-4, FRAC_PI_2 - 1e-4);
        LightTexture::new(texture.image.id(), place, angle.tan())
    }
}

/// The textures of lights in the table of textures, and their records.
#[derive(Default)]
pub(super) struct LightTextures {
    /// Whether Bevy's shaders read textures of lights; `None` until that is known.
    shine: Option<bool>,
    /// The textures of the last call, each with its light.
    wanted: Vec<(u32, LightTexture)>,
    /// By texture, its image if it was added to the table.
    images: Vec<Option<AssetId<Image>>>,
    /// By texture, its light.
    lights: Vec<u32>,
    records: Vec<GpuLightTexture>,
}

impl LightTextures {
    /// Detects whether Bevy's own lighting reads textures of lights.
    pub fn detect(&mut self, lighting: Option<&DeferredLightingLayout>) {
        self.shine = self.shine.or_else(|| lighting_defines(lighting, DEFINITION));
    }

    /// Updates the textures, each with its light. `resettled` are images that were loaded or have new content. Returns whether
    /// anything has changed.
    pub fn follow(
        &mut self,
        wanted: &[(u32, LightTexture)],
        resettled: &HashSet<AssetId<Image>>,
        table: &mut TextureTable,
    ) -> bool {
        let wanted = if self.shine == Some(true) { wanted } else { &[] };
        let is_same = self.wanted == wanted && self.images.iter().all(Option::is_some);
        if is_same && !wanted.iter().any(|(_, texture)| resettled.contains(&texture.image)) {
            return false;
        }
        self.wanted = wanted.to_vec();
        // New images come first, so that unchanged images keep their index.
        let acquired = wanted.iter().map(|(_, texture)| texture.image);
        let images = acquired.map(|image| table.acquire(image).then_some(image)).collect();
        let old: Vec<_> = core::mem::replace(&mut self.images, images);
        old.into_iter().flatten().for_each(|image| table.release(image));
        let lights: Vec<u32> = wanted.iter().map(|(light, _)| *light).collect();
        let textures = wanted.iter().zip(&self.images);
        let records: Vec<GpuLightTexture> = textures
            .map(|((_, texture), image)| GpuLightTexture {
                light_from_world: texture.light_from_world,
                projection: texture.projection,
                texture: image.and_then(|image| table.packed(image)).unwrap_or(NO_TEXTURE),
                ..Default::default()
            })
            .collect();
        let mut shown = self.images.iter().flatten();
        let changed = lights != self.lights || records != self.records || shown.any(|image| resettled.contains(image));
        (self.lights, self.records) = (lights, records);
        changed
    }

    /// Returns whether no light has a texture.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Sets the texture numbers of lights in a buffer, and appends the records. `place_of` returns the index of a light.
    pub fn append_to(&self, table: &mut Vec<GpuLight>, place_of: impl Fn(u32) -> usize) {
        for (number, light) in (1..).zip(&self.lights) {
            if let Some(light) = table.get_mut(place_of(*light)) {
                light.flags |= number << LIGHT_TEXTURE_SHIFT;
            }
        }
        table.extend(self.records.iter().map(|record| bytemuck::cast::<_, GpuLight>(*record)));
    }

    /// Records for this number of lights, for tests.
    #[cfg(test)]
    pub fn with_records(count: u32) -> Self {
        Self {
            lights: (0..count).collect(),
            records: vec![GpuLightTexture::default(); count as usize],
            ..Self::default()
        }
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.records.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        gpu_types::{LIGHT_CASTS_SHADOW, LIGHT_POINT},
        test_gpu,
    };
    use bevy::{asset::uuid::Uuid, ecs::world::FromWorld};

    fn texture(number: u128) -> LightTexture {
        let uuid = Uuid::from_u128(number);
        let place = GlobalTransform::from_xyz(number as f32, 0.0, 0.0);
        LightTexture::new(AssetId::Uuid { uuid }, &place, 0.0).expect("it can be inverted")
    }

    #[test]
    fn images_are_given_back_and_lights_refer_to_records() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let mut world = World::new();
        world.insert_resource(device);
        world.insert_resource(queue);
        let mut table = TextureTable::from_world(&mut world);
        let mut textures = LightTextures::default();
        let two = [(2, texture(5)), (0, texture(6))];
        let none = HashSet::default();
        assert!(
            !textures.follow(&two, &none, &mut table),
            "it isn't known that they shine"
        );
        textures.shine = Some(true);
        assert!(textures.follow(&two, &none, &mut table));
        assert!(!textures.follow(&two, &none, &mut table), "nothing has changed");
        let other: HashSet<_> = core::iter::once(two[0].1.image).collect();
        assert!(textures.follow(&two, &other, &mut table), "it has other content");
        assert_eq!((textures.len(), table.used()), (2, 2));

        let light = GpuLight {
            kind: LIGHT_POINT,
            flags: LIGHT_CASTS_SHADOW,
            ..Default::default()
        };
        let mut lights = vec![light; 3];
        textures.append_to(&mut lights, |light| light as usize);
        let flags: Vec<u32> = lights[..3].iter().map(|light| light.flags).collect();
        let number = |number: u32| LIGHT_CASTS_SHADOW | number << LIGHT_TEXTURE_SHIFT;
        assert_eq!(flags, [number(2), LIGHT_CASTS_SHADOW, number(1)]);
        let records: Vec<GpuLightTexture> = lights[3..].iter().map(|light| bytemuck::cast(*light)).collect();
        assert_eq!(records, textures.records);
        assert_eq!(records[0].light_from_world[0], [1.0, 0.0, 0.0, -5.0]);

        assert!(textures.follow(&two[1..], &none, &mut table), "one is gone");
        assert_eq!((textures.len(), table.used()), (1, 1));
        assert!(
            textures.follow(&[(1, texture(6))], &none, &mut table),
            "another light has it"
        );
        textures.shine = Some(false);
        assert!(textures.follow(&two, &none, &mut table), "Bevy reads none");
        assert!(textures.is_empty() && table.used() == 0);
    }

    #[test]
    fn textures_of_collapsed_lights_are_left_out() {
        let mut world = World::new();
        let flat = GlobalTransform::from_scale(bevy::math::Vec3::new(1.0, 0.0, 1.0));
        let spot = SpotLightTexture {
            image: bevy::asset::Handle::default(),
        };
        let good = world.spawn((spot.clone(), GlobalTransform::IDENTITY)).id();
        let bad = world.spawn((spot, flat)).id();
        let mut state = bevy::ecs::system::SystemState::<LightTextureWorld>::new(&mut world);
        let textures = state.get(&world).expect("all parameters are there");
        assert!(textures.kinds().contains(&true));
        let angle = SpotLight::default().outer_angle;
        let found = textures.of_spot(good).expect("it has a texture");
        assert!((found.projection - angle.tan()).abs() < 1e-6);
        assert!(textures.of_spot(bad).is_none() && textures.of_point(good).is_none());
    }
}
