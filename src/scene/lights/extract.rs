//! Extracts lights: only changed lights are converted again.

use super::{ExtractedLights, MAX_LIGHTS, keep_strongest};
use crate::scene::{
    change_ticks::{Clock, blocks},
    gpu_types::{GpuLight, LIGHT_CASTS_SHADOW, LIGHT_VOLUMETRIC},
    light_textures::{LightTexture, LightTextureWorld},
    pack_lights::{directional_light, non_negative, point_light, rect_light, spot_light},
    render_layers::SceneLayers,
};
use bevy::{
    camera::visibility::{InheritedVisibility, RenderLayers},
    ecs::{prelude::*, system::SystemParam},
    light::{DirectionalLight, PointLight, RectLight, SpotLight, SunDisk, VolumetricLight},
    log::warn_once,
    transform::components::GlobalTransform,
};

/// Lights of one kind.
type Lights<'w, 's, L> = Query<
    'w,
    's,
    (
        Entity,
        Ref<'static, L>,
        Ref<'static, GlobalTransform>,
        Ref<'static, InheritedVisibility>,
        Option<Ref<'static, RenderLayers>>,
    ),
>;

/// The lights of the main world.
#[derive(SystemParam)]
pub struct LightWorld<'w, 's> {
    directional: Lights<'w, 's, DirectionalLight>,
    disks: Query<'w, 's, &'static SunDisk>,
    volumetric: Query<'w, 's, (), With<VolumetricLight>>,
    points: Lights<'w, 's, PointLight>,
    spots: Lights<'w, 's, SpotLight>,
    rects: Lights<'w, 's, RectLight>,
    textures: LightTextureWorld<'w, 's>,
}

/// Index of lights that give no light.
const DARK: u32 = u32::MAX;

/// Lights of one kind from the last extraction, in the order of their query.
#[derive(Default)]
struct Known {
    entities: Vec<Entity>,
    /// By entity, the index of its light, or [`DARK`].
    lights: Vec<u32>,
    /// For each table of the world, its number of entities, and whether they have their own layers.
    tables: Vec<(usize, bool)>,
}

impl Known {
    /// Adds all lights of a kind to a list.
    fn gather<L: Component>(&mut self, all: &Lights<L>, conversion: &Conversion<L>, lights: &mut Vec<GpuLight>) {
        self.entities.clear();
        self.lights.clear();
        self.tables.clear();
        let Ok(tables) = all.contiguous_iter() else {
            // All of these components are stored in tables, unless a future version of Bevy stores one elsewhere.
            lights.extend(all.iter().filter_map(|(_, light, transform, visibility, layers)| {
                conversion.of(&light, &transform, *visibility, layers.as_deref())
            }));
            return;
        };
        for (entities, sources, transforms, visibilities, layers) in tables {
            self.tables.push((entities.len(), layers.is_some()));
            self.entities.extend_from_slice(entities);
            for row in 0..entities.len() {
                let layers = layers.as_ref().map(|layers| &layers[row]);
                let light = conversion.of(&sources[row], &transforms[row], visibilities[row], layers);
                self.lights.push(light.map_or(DARK, |_| lights.len() as u32));
                lights.extend(light);
            }
        }
    }

    /// Finds lights that changed since the last frame: `None` for one that stopped giving light. Returns false if a light was added or
    /// removed, or if one without a place in the list started to give light.
    fn find_changes<L: Component>(
        &self,
        all: &Lights<L>,
        conversion: &Conversion<L>,
        changed: &mut Vec<(u32, Option<GpuLight>)>,
    ) -> bool {
        let Ok(tables) = all.contiguous_iter() else {
            return false;
        };
        let mut known_tables = self.tables.iter();
        let mut first = 0;
        for (entities, sources, transforms, visibilities, layers) in tables {
            let known = self.entities.get(first..first + entities.len());
            if known_tables.next() != Some(&(entities.len(), layers.is_some())) || known != Some(entities) {
                return false;
            }
            let clock = Clock::new(transforms.this_run_tick(), transforms.last_run_tick());
            let columns = [
                Some(sources.changed_ticks_slice()),
                Some(transforms.changed_ticks_slice()),
                Some(visibilities.changed_ticks_slice()),
                layers.as_ref().map(|layers| layers.changed_ticks_slice()),
            ];
            for rows in blocks(entities.len()) {
                if !columns
                    .iter()
                    .flatten()
                    .any(|ticks| clock.any_is_new(&ticks[rows.clone()]))
                {
                    continue;
                }
                for row in rows {
                    if !columns.iter().flatten().any(|ticks| clock.is_new(ticks[row])) {
                        continue;
                    }
                    let layers = layers.as_ref().map(|layers| &layers[row]);
                    let light = conversion.of(&sources[row], &transforms[row], visibilities[row], layers);
                    match (self.lights[first + row], light) {
                        (DARK, None) => {}
                        (DARK, Some(_)) => return false,
                        (place, light) => changed.push((place, light)),
                    }
                }
            }
            first += entities.len();
        }
        first == self.entities.len() && known_tables.next().is_none()
    }
}

impl Known {
    /// Finds textures of lights, each with the index of its light.
    fn textures(&self, of: impl Fn(Entity) -> Option<LightTexture>) -> impl Iterator<Item = (u32, LightTexture)> {
        let lights = self.entities.iter().zip(&self.lights);
        lights.filter_map(move |(entity, light)| (*light != DARK).then(|| Some((*light, of(*entity)?)))?)
    }

    /// Applies other components of the entity to a directional light at an index of the list.
    fn dress(&self, place: u32, light: &mut GpuLight, world: &LightWorld) {
        let row = self.lights.iter().position(|light| *light == place);
        if let Some(entity) = row.and_then(|row| self.entities.get(row)) {
            *light = dressed(*light, *entity, world);
        }
    }

    /// Returns whether all directional lights in the list match these components.
    fn are_dressed(&self, lights: &[GpuLight], world: &LightWorld) -> bool {
        let rows = self.entities.iter().zip(&self.lights);
        rows.filter_map(|(entity, light)| Some((entity, lights.get(*light as usize)?)))
            .all(|(entity, light)| *light == dressed(*light, *entity, world))
    }
}

/// Returns a directional light with the angle of its disk in radians, and whether it is visible in fog: in Bevy, only with a shadow map.
fn dressed(light: GpuLight, entity: Entity, world: &LightWorld) -> GpuLight {
    let disk = world.disks.get(entity).ok();
    let is_volumetric = light.flags & LIGHT_CASTS_SHADOW != 0 && world.volumetric.contains(entity);
    GpuLight {
        radius: non_negative(disk.unwrap_or_default().angular_size),
        flags: light.flags & !LIGHT_VOLUMETRIC | if is_volumetric { LIGHT_VOLUMETRIC } else { 0 },
        ..light
    }
}

/// Converts components to a light.
struct Conversion<'a, L> {
    layers: &'a SceneLayers,
    convert: fn(&L, &GlobalTransform) -> Option<GpuLight>,
}

impl<L> Conversion<'_, L> {
    /// Returns `None` for a light that gives no light.
    fn of(
        &self,
        light: &L,
        transform: &GlobalTransform,
        visibility: InheritedVisibility,
        own_layers: Option<&RenderLayers>,
    ) -> Option<GpuLight> {
        // Bevy lights a view only by the lights on its layers.
        let shines = visibility.get() && self.layers.groups_of(own_layers) != 0;
        shines.then(|| (self.convert)(light, transform))?
    }
}

/// All kinds of lights from the last extraction.
#[derive(Default)]
pub struct KnownLights {
    directional: Known,
    points: Known,
    spots: Known,
    rects: Known,
    /// Whether they include rectangles.
    with_rects: bool,
    changed: Vec<(u32, Option<GpuLight>)>,
}

impl KnownLights {
    /// Finds changed lights. Returns false if all lights must be gathered again.
    fn find_changes(&mut self, world: &LightWorld, layers: &SceneLayers) -> bool {
        let changed = &mut self.changed;
        changed.clear();
        if !self
            .directional
            .find_changes(&world.directional, &of(directional_light, layers), changed)
        {
            return false;
        }
        for (place, light) in &mut *changed {
            if let Some(light) = light {
                self.directional.dress(*place, light, world);
            }
        }
        self.points
            .find_changes(&world.points, &of(point_light, layers), changed)
            && self.spots.find_changes(&world.spots, &of(spot_light, layers), changed)
            && (!self.with_rects || self.rects.find_changes(&world.rects, &of(rect_light, layers), changed))
    }

    /// Returns all lights.
    fn gather(&mut self, world: &LightWorld, layers: &SceneLayers) -> Vec<GpuLight> {
        let mut lights = Vec::new();
        self.directional
            .gather(&world.directional, &of(directional_light, layers), &mut lights);
        for (place, light) in (0..).zip(&mut lights) {
            self.directional.dress(place, light, world);
        }
        if lights.len() > MAX_LIGHTS {
            warn_once!(
                "{} directional lights in the scene: reflections show the {MAX_LIGHTS} strongest of them.",
                lights.len()
            );
            keep_strongest(&mut lights);
            // Cleared, since other lights might be among the strongest in the next frame.
            self.directional = Known::default();
        }
        self.points.gather(&world.points, &of(point_light, layers), &mut lights);
        self.spots.gather(&world.spots, &of(spot_light, layers), &mut lights);
        if self.with_rects {
            self.rects.gather(&world.rects, &of(rect_light, layers), &mut lights);
        }
        lights
    }
}

/// All textures of lights.
fn textures(known: &KnownLights, world: &LightTextureWorld) -> Vec<(u32, LightTexture)> {
    // Kinds of lights without textures are skipped.
    let [directional, points, spots] = world.kinds();
    let mut textures = Vec::new();
    if directional {
        textures.extend(known.directional.textures(|light| world.of_directional(light)));
    }
    if points {
        textures.extend(known.points.textures(|light| world.of_point(light)));
    }
    if spots {
        textures.extend(known.spots.textures(|light| world.of_spot(light)));
    }
    textures
}

fn of<L>(convert: fn(&L, &GlobalTransform) -> Option<GpuLight>, layers: &SceneLayers) -> Conversion<'_, L> {
    Conversion { layers, convert }
}

/// Updates the extracted lights.
pub fn extract_lights(
    world: &LightWorld,
    active: bool,
    layers: &SceneLayers,
    extracted: &mut ExtractedLights,
    known: &mut KnownLights,
) {
    if !active {
        extracted.clear();
        // Changes aren't tracked until a camera reflects again.
        *known = KnownLights::default();
        return;
    }
    let is_other = known.with_rects != extracted.rects_shine || layers.changed || extracted.has_many_dark();
    known.with_rects = extracted.rects_shine;
    if !is_other && known.directional.are_dressed(extracted.lights(), world) && known.find_changes(world, layers) {
        for (place, light) in &known.changed {
            extracted.set(*place, light.unwrap_or_else(|| extracted.darkened(*place)));
        }
        extracted.mark();
    } else {
        extracted.replace(known.gather(world, layers));
    }
    extracted.textures = textures(known, &world.textures);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        change::{Change, RESTLESS_FRAMES},
        gpu_types::{LIGHT_DIRECTIONAL, LIGHT_RESTLESS},
        lights::{Touched, is_dark},
    };
    use bevy::{ecs::system::SystemState, math::Vec3};

    fn spawn(world: &mut World, index: usize) -> Entity {
        let place = GlobalTransform::from_translation(Vec3::splat(index as f32));
        let mut light = world.spawn((place, InheritedVisibility::VISIBLE));
        match index % 4 {
            0 => light.insert(DirectionalLight::default()),
            1 => light.insert(PointLight::default()),
            2 => light.insert(SpotLight::default()),
            _ => light.insert((PointLight::default(), RenderLayers::from_layers(&[0, 1]))),
        };
        light.id()
    }

    /// Layers of a camera that draws the default layer.
    fn usual_layers() -> SceneLayers {
        let mut layers = SceneLayers::default();
        layers.follow(core::iter::once((None, None)), core::iter::empty());
        layers.changed = false;
        layers
    }

    /// Changes the world in one of several ways. Returns whether lights keep their indices in the list.
    fn disturb(world: &mut World, lights: &mut Vec<Entity>, step: usize) -> bool {
        let light = lights[step * 7 % lights.len()];
        let mut entity = world.entity_mut(light);
        let is_on_layers = entity.contains::<RenderLayers>();
        match step % 8 {
            0 | 1 => entity.insert(GlobalTransform::from_xyz(step as f32, 1.0, 2.0)),
            2 if entity.contains::<PointLight>() => entity.insert(PointLight {
                intensity: step as f32,
                ..Default::default()
            }),
            // The light is hidden or shown.
            3 => {
                let was_visible = entity
                    .get::<InheritedVisibility>()
                    .is_some_and(|visibility| visibility.get());
                entity.insert(if was_visible {
                    InheritedVisibility::HIDDEN
                } else {
                    InheritedVisibility::VISIBLE
                });
                return false;
            }
            4 if is_on_layers => {
                entity.insert(RenderLayers::layer(1 + step % 2));
                return false;
            }
            5 if is_on_layers => {
                entity.remove::<RenderLayers>();
                return false;
            }
            6 => {
                entity.despawn();
                lights.retain(|other| *other != light);
                lights.push(spawn(world, step));
                return false;
            }
            _ => return true,
        };
        true
    }

    #[test]
    fn lights_that_changed_are_converted_and_others_kept() {
        let mut world = World::new();
        let mut state = SystemState::<LightWorld>::new(&mut world);
        let layers = usual_layers();
        let mut entities: Vec<Entity> = (0..300).map(|index| spawn(&mut world, index)).collect();
        let (mut extracted, mut known) = (ExtractedLights::default(), KnownLights::default());
        let mut copy = Vec::new();
        for step in 0..400 {
            let stays = step > 0 && disturb(&mut world, &mut entities, step);
            let lights = state.get(&world).expect("all parameters are there");
            extract_lights(&lights, true, &layers, &mut extracted, &mut known);
            let all = KnownLights::default().gather(&lights, &layers);
            let without_mark = |light: &GpuLight| GpuLight {
                flags: light.flags & !LIGHT_RESTLESS,
                ..*light
            };
            let bright = extracted.lights().iter().filter(|light| !is_dark(light));
            assert!(bright.map(without_mark).eq(all), "step {step}");
            let (touched, _) = extracted.take_changes(Vec3::ZERO);
            assert!(!stays || touched != Touched::All, "step {step}");
            match touched {
                Touched::All => copy = extracted.lights().to_vec(),
                Touched::Lights(touched) => {
                    for light in touched {
                        copy[light as usize] = extracted.lights()[light as usize];
                    }
                }
            }
            assert!(copy == extracted.lights(), "step {step}");
        }
    }

    /// A lamp that flickers to zero costs no more than one that changes its colour.
    #[test]
    fn lights_that_blink_keep_their_places() {
        let mut world = World::new();
        let mut state = SystemState::<LightWorld>::new(&mut world);
        let layers = usual_layers();
        let lamps: Vec<Entity> = (0..400).map(|index| spawn(&mut world, 4 * index + 1)).collect();
        let (mut extracted, mut known) = (ExtractedLights::default(), KnownLights::default());
        let mut frame = |world: &World| {
            let lights = state.get(world).expect("all parameters are there");
            extract_lights(&lights, true, &layers, &mut extracted, &mut known);
            let dark = extracted.lights().iter().filter(|light| is_dark(light)).count();
            (dark, extracted.lights().len(), extracted.take_changes(Vec3::ZERO))
        };
        let set = |world: &mut World, lamps: &[Entity], intensity: f32| {
            for lamp in lamps {
                world.get_mut::<PointLight>(*lamp).unwrap().intensity = intensity;
            }
        };
        frame(&world);
        // It casts shadows, which a dark one doesn't.
        world.get_mut::<PointLight>(lamps[7]).unwrap().shadow_maps_enabled = true;
        frame(&world);
        for (intensity, dark) in [(0.0, 1), (9.0, 0), (0.0, 1)] {
            set(&mut world, &lamps[7..8], intensity);
            let expected = (Touched::Lights(vec![7]), Change::Marked);
            let (found, all, (touched, change)) = frame(&world);
            assert_eq!((found, all), (dark, 400));
            assert_eq!(change, expected.1);
            assert!(matches!(touched, Touched::Lights(lights) if lights.iter().all(|light| *light == 7)));
        }
        // If many stay dark, hits don't evaluate them any longer.
        set(&mut world, &lamps[100..], 0.0);
        assert_eq!(frame(&world).0, 301);
        let (dark, all, (touched, _)) = frame(&world);
        assert_eq!((dark, all, touched), (0, 99, Touched::All));
    }

    #[test]
    fn the_disk_of_a_sun_is_followed() {
        let mut world = World::new();
        let mut state = SystemState::<LightWorld>::new(&mut world);
        let layers = usual_layers();
        // The second light isn't directional, so that indices and rows differ.
        let [_, _, sun] = [0, 1, 0].map(|index| spawn(&mut world, index));
        let (mut extracted, mut known) = (ExtractedLights::default(), KnownLights::default());
        let mut disks = |world: &World| {
            let lights = state.get(world).expect("all parameters are there");
            extract_lights(&lights, true, &layers, &mut extracted, &mut known);
            let suns = extracted
                .lights()
                .iter()
                .filter(|light| light.kind == LIGHT_DIRECTIONAL);
            let mut disks: Vec<f32> = suns.map(|light| light.radius).collect();
            disks.sort_by(f32::total_cmp);
            disks
        };
        let usual = SunDisk::default().angular_size;
        assert_eq!(disks(&world), [usual; 2]);
        let set = |world: &mut World, angular_size| {
            world.entity_mut(sun).insert(SunDisk {
                angular_size,
                ..Default::default()
            });
        };
        set(&mut world, 0.5);
        assert_eq!(disks(&world), [usual, 0.5], "one comes");
        set(&mut world, 0.7);
        // The disk is updated even if something else changes in the same frame.
        world.entity_mut(sun).insert(GlobalTransform::from_xyz(1.0, 0.0, 0.0));
        assert_eq!(disks(&world), [usual, 0.7], "it changes");
        set(&mut world, f32::NAN);
        assert_eq!(disks(&world), [0.0, usual], "it is not a number");
        world.entity_mut(sun).remove::<SunDisk>();
        assert_eq!(disks(&world), [usual; 2], "it goes");
    }

    #[test]
    fn lights_that_changed_keep_a_mark_for_a_while() {
        let mut world = World::new();
        let mut state = SystemState::<LightWorld>::new(&mut world);
        let layers = usual_layers();
        let lights = [1, 5].map(|index| spawn(&mut world, index));
        let (mut extracted, mut known) = (ExtractedLights::default(), KnownLights::default());
        let mut frame = |world: &World| {
            let lights = state.get(world).expect("all parameters are there");
            extract_lights(&lights, true, &layers, &mut extracted, &mut known);
            let marks = extracted.lights().iter().map(|light| light.flags & LIGHT_RESTLESS != 0);
            let marks: Vec<bool> = marks.collect();
            (marks, extracted.take_changes(Vec3::ZERO))
        };
        frame(&world);
        let shift = |world: &mut World, x: f32| {
            world
                .entity_mut(lights[1])
                .insert(GlobalTransform::from_xyz(x, 0.0, 0.0));
        };
        shift(&mut world, 3.0);
        let moved = Touched::Lights(vec![1]);
        let (marks, (touched, change)) = frame(&world);
        assert_eq!(
            (marks, change),
            (vec![false, true], Change::Unmarked),
            "it begins to move"
        );
        assert!(!touched.is_empty() && touched != Touched::All);
        shift(&mut world, 4.0);
        assert_eq!(frame(&world), (vec![false, true], (moved.clone(), Change::Marked)));
        for _ in 1..RESTLESS_FRAMES {
            assert_eq!(frame(&world), (vec![false, true], Default::default()));
        }
        assert_eq!(frame(&world), (vec![false, false], (moved, Change::Nothing)));
        assert_eq!(frame(&world), (vec![false, false], Default::default()));
    }
}
