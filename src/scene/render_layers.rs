//! Render layers: reflections show the layers that their camera draws, or the layers in its [`ReflectedLayers`]. Each different set of
//! layers is a group. An object has a bit for each of its groups; shaders test the bits only if there are several groups.

use crate::settings::ReflectedLayers;
use bevy::{
    camera::visibility::{InheritedVisibility, RenderLayers},
    ecs::prelude::*,
    light::{DirectionalLight, PointLight, SpotLight},
    log::warn_once,
};

/// Maximum number of groups: unused bits of a cull mask.
pub const MAX_GROUPS: usize = 5;
/// Bit of the first group in the flags of instances. In the flags of environments, it is for the group that reflections show.
const FIRST_GROUP: u32 = 27;
/// Number of bits by which a camera's drawn group is below its reflected group.
const DRAWN_SHIFT: u32 = 5;

/// The layers of reflecting cameras.
#[derive(Resource, Default)]
pub struct SceneLayers {
    /// The layers of each group.
    groups: Vec<RenderLayers>,
    /// Layers of the lights that shine for a camera and cast shadows.
    lit: RenderLayers,
    /// All objects must be looked at: the groups differ from the last frame, or lights came to the default layer or left it.
    pub changed: bool,
    /// The layers on which lights cast shadows have changed, which affects objects with their own layers.
    pub lit_changed: bool,
}

impl SceneLayers {
    /// The groups of an object on these layers, as bits of its flags.
    pub fn groups_of(&self, layers: Option<&RenderLayers>) -> u32 {
        let default = RenderLayers::default();
        let layers = layers.unwrap_or(&default);
        let groups = (FIRST_GROUP..).zip(&self.groups);
        groups.fold(0, |bits, (bit, group)| {
            bits | (u32::from(group.intersects(layers)) << bit)
        })
    }

    /// The groups of a camera, as bits of its environment's flags.
    pub fn groups_of_camera(&self, drawn: Option<&RenderLayers>, reflected: Option<&ReflectedLayers>) -> u32 {
        let shown = reflected.map(|layers| &layers.0).or(drawn);
        self.group_of(shown) | (self.group_of(drawn) >> DRAWN_SHIFT)
    }

    /// The group of a set of layers.
    fn group_of(&self, layers: Option<&RenderLayers>) -> u32 {
        let default = RenderLayers::default();
        let layers = layers.unwrap_or(&default);
        let found = self.groups.iter().position(|group| group == layers);
        // The last group combines the layers of all cameras beyond the limit.
        1 << (FIRST_GROUP + found.unwrap_or(MAX_GROUPS - 1) as u32)
    }

    /// Returns whether an object on these layers casts shadows, even if no camera shows it.
    pub fn casts_shadow(&self, layers: Option<&RenderLayers>) -> bool {
        self.lit.intersects(layers.unwrap_or(&RenderLayers::default()))
    }

    /// Returns whether there are several groups.
    pub fn differ(&self) -> bool {
        self.groups.len() > 1
    }

    /// Updates the layers from this frame's cameras, with the layers that they draw and that their reflections show, and from its lights.
    pub fn follow<'a>(
        &mut self,
        cameras: impl Iterator<Item = (Option<&'a RenderLayers>, Option<&'a ReflectedLayers>)>,
        lights: impl Iterator<Item = &'a RenderLayers>,
    ) {
        let cameras = cameras.flat_map(|(drawn, reflected)| {
            let reflected = reflected.map(|layers| Some(&layers.0));
            [Some(drawn), reflected].into_iter().flatten()
        });
        let mut groups: Vec<_> = cameras.map(|layers| layers.cloned().unwrap_or_default()).collect();
        groups.sort_unstable();
        groups.dedup();
        if groups.len() > MAX_GROUPS {
            warn_once!(
                "reflecting cameras name {} different sets of render layers: beyond {MAX_GROUPS}, reflections show more than their \
                 camera's",
                groups.len()
            );
            let others = groups.drain(MAX_GROUPS - 1..);
            let union = others.fold(RenderLayers::none(), |union, layers| union | layers);
            groups.push(union);
        }
        let changed = groups != self.groups;
        self.groups = groups;
        self.follow_lights(lights);
        self.changed |= changed;
    }

    /// Updates only the layers of this frame's lights that cast shadows and have layers of their own. All others are on the default layer.
    pub fn follow_lights<'a>(&mut self, lights: impl Iterator<Item = &'a RenderLayers>) {
        let shines = |layers: &RenderLayers| self.groups_of(Some(layers)) != 0;
        let others = Some(RenderLayers::default())
            .filter(shines)
            .unwrap_or(RenderLayers::none());
        let shining = lights.filter(|layers| shines(layers));
        let lit = shining.fold(others, |union, layers| union | layers.clone());
        // Most objects have no layers of their own.
        let concerns_all = |lit: &RenderLayers| lit.intersects(&RenderLayers::default());
        self.changed = concerns_all(&lit) != concerns_all(&self.lit);
        self.lit_changed = lit != self.lit;
        self.lit = lit;
    }
}

type AnyLight = AnyOf<(&'static DirectionalLight, &'static PointLight, &'static SpotLight)>;

/// Lights with layers of their own.
pub(super) type LightLayers<'w, 's> = Query<'w, 's, (&'static RenderLayers, &'static InheritedVisibility, AnyLight)>;

/// Layers of the visible ones that cast shadows.
pub(super) fn layers_of_shadows<'a>(lights: &'a LightLayers) -> impl Iterator<Item = &'a RenderLayers> {
    let casts_shadows = |(sun, point, spot): (Option<&DirectionalLight>, Option<&PointLight>, Option<&SpotLight>)| {
        sun.is_some_and(|light| light.shadow_maps_enabled)
            || point.is_some_and(|light| light.shadow_maps_enabled)
            || spot.is_some_and(|light| light.shadow_maps_enabled)
    };
    lights
        .iter()
        .filter(move |(_, visibility, light)| visibility.get() && casts_shadows(*light))
        .map(|(layers, ..)| layers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn followed<const N: usize>(cameras: [Option<RenderLayers>; N]) -> SceneLayers {
        let mut layers = SceneLayers::default();
        layers.follow(
            cameras.iter().map(|layers| (layers.as_ref(), None)),
            core::iter::empty(),
        );
        layers
    }

    #[test]
    fn cameras_of_the_same_layers_are_one_group() {
        let layers = followed([None, Some(RenderLayers::layer(0)), None]);
        assert!(!layers.differ());
        let [default, other] = [0, 1].map(RenderLayers::layer);
        assert_eq!(layers.group_of(None), 1 << FIRST_GROUP);
        assert_eq!(layers.groups_of(None), 1 << FIRST_GROUP);
        assert_eq!(layers.groups_of(Some(&default)), 1 << FIRST_GROUP);
        assert_eq!(layers.groups_of(Some(&other)), 0);
    }

    #[test]
    fn each_group_draws_its_own_objects() {
        let [first, second] = [RenderLayers::layer(0), RenderLayers::from_layers(&[1, 2])];
        let layers = followed([Some(second.clone()), Some(first.clone())]);
        assert!(layers.differ());
        let [a, b] = [&first, &second].map(|group| layers.group_of(Some(group)));
        assert_ne!(a, b);
        assert_eq!(layers.groups_of(None), a);
        assert_eq!(layers.groups_of(Some(&RenderLayers::layer(2))), b);
        assert_eq!(layers.groups_of(Some(&RenderLayers::from_layers(&[0, 2]))), a | b);
        assert_eq!(layers.groups_of(Some(&RenderLayers::layer(3))), 0);
    }

    #[test]
    fn reflections_may_show_other_layers_than_their_camera_draws() {
        let shown = ReflectedLayers(RenderLayers::from_layers(&[0, 1]));
        let layers = followed([None, Some(shown.0.clone())]);
        let (drawn, mirrored) = (layers.group_of(None), layers.group_of(Some(&shown.0)));
        assert_ne!(drawn, mirrored);
        assert_eq!(layers.groups_of(Some(&RenderLayers::layer(1))), mirrored);
        assert_eq!(
            layers.groups_of_camera(None, Some(&shown)),
            mirrored | (drawn >> DRAWN_SHIFT)
        );
        assert_eq!(layers.groups_of_camera(None, None), drawn | (drawn >> DRAWN_SHIFT));
    }

    #[test]
    fn too_many_groups_share_the_last_one() {
        let layers = followed([0, 1, 2, 3, 4, 5, 6].map(|layer| Some(RenderLayers::layer(layer))));
        let last = 1 << (FIRST_GROUP + MAX_GROUPS as u32 - 1);
        let in_last = (0..7).filter(|layer| layers.group_of(Some(&RenderLayers::layer(*layer))) == last);
        assert_eq!(in_last.count(), 3);
        let shown = (0..7).filter(|layer| layers.groups_of(Some(&RenderLayers::layer(*layer))) == last);
        assert_eq!(shown.count(), 3);
    }

    #[test]
    fn lights_decide_on_which_layers_shadows_are_cast() {
        let [default, other] = [0, 1].map(RenderLayers::layer);
        let both = RenderLayers::from_layers(&[0, 1]);
        let mut layers = followed([None]);
        assert!(layers.casts_shadow(None) && layers.casts_shadow(Some(&default)));
        assert!(!layers.casts_shadow(Some(&other)));
        layers.follow([(None, None)].into_iter(), [&other].into_iter());
        assert!(!layers.casts_shadow(Some(&other)), "it doesn't shine for the camera");
        layers.follow([(None, None)].into_iter(), [&both].into_iter());
        assert!(layers.lit_changed && layers.casts_shadow(Some(&other)) && layers.casts_shadow(None));
        assert!(
            !layers.changed,
            "objects without layers of their own cast shadows as before"
        );
        layers.follow([(None, None)].into_iter(), [&both].into_iter());
        assert!(!layers.lit_changed);
        let mut aside = followed([Some(other.clone())]);
        assert!(
            !aside.casts_shadow(None),
            "a camera on another layer needs no object of this one"
        );
        aside.follow([(Some(&other), None)].into_iter(), [&both].into_iter());
        assert!(
            aside.changed && aside.casts_shadow(None),
            "its light shows their shadows"
        );
    }
}
