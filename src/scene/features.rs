//! Features that shaders are compiled with: one bit for each feature of the scene, the views and the app, and one table row with its
//! definition and the passes that use it.

use crate::settings::{ClampedSettings, ReflectionWarmUp};
use bitflags::bitflags;

bitflags! {
    /// Features that shaders are compiled with or without.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Features: u32 {
        /// Rays can hit objects that need the alpha test. Always set with ray queries, whose shaders don't differ.
        const MASKED = 1;
        /// The scene's trees need a larger stack.
        const DEEP_TREES = 1 << 1;
        /// Reflecting cameras draw different layers.
        const RENDER_LAYERS = 1 << 2;
        /// Some object tints the light that passes through it.
        const TINTS = 1 << 3;
        /// Some object lets a part of the rays through. Exact mirrors trace its layers deterministically.
        const LAYERS = 1 << 4;
        /// Some object refracts first rays.
        const REFRACTION = 1 << 5;
        /// There are light probes.
        const LIGHT_PROBES = 1 << 6;
        /// There are enough lights for hits to sample some of them.
        const LIGHT_SAMPLING = 1 << 7;
        /// There are more lights than hits have bits for (`SHARED_LIGHTS` of `shading.wesl`), or fog or particles that lights shine on: the
        /// pass that shades hits then traces rays.
        const MANY_LIGHTS = 1 << 8;
        /// Some view is in an atmosphere.
        const ATMOSPHERE = 1 << 9;
        /// The atmosphere adds haze in front of the surfaces of some view.
        const HAZE = 1 << 10;
        /// Some object has a lightmap.
        const LIGHTMAPS = 1 << 11;
        /// Some material has a clearcoat.
        const CLEARCOAT = 1 << 12;
        /// Diffuse light comes through some material.
        const DIFFUSE_TRANSMISSION = 1 << 13;
        /// There are rectangular lights.
        const RECT_LIGHTS = 1 << 14;
        /// Some light has a texture.
        const LIGHT_TEXTURES = 1 << 15;
        /// Some view has fog volumes.
        const FOG_VOLUMES = 1 << 16;
        /// Some fog volume has a density texture.
        const FOG_DENSITY = 1 << 17;
        /// Bevy draws opaque surfaces forward.
        const FORWARD_SURFACES = 1 << 18;
        /// The app's shader modifies the surfaces of hits.
        const SURFACE_SHADER = 1 << 19;
        /// The view follows rays beyond their first hit.
        const BOUNCES = 1 << 20;
        /// Hits take light from the camera's last frame.
        const SCREEN_TRACES = 1 << 21;
        /// Rays also march through the camera's depth.
        const SCREEN_MARCH = 1 << 22;
        /// Some object is see-through or has a depth bias: surfaces in the same place have an order.
        const COPLANAR = 1 << 23;
        /// Some entity has particles.
        const PARTICLES = 1 << 24;
        /// Some of them are lit.
        const LIT_PARTICLES = 1 << 25;
        /// There are clustered decals, and materials that show them.
        const DECALS = 1 << 26;
        /// Some forward material has a specular tint in a colour.
        const SPECULAR_TINT = 1 << 27;
    }
}

bitflags! {
    /// Passes that are compiled for the scene.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub struct Passes: u8 {
        /// Traces rays of blocks to their first hit.
        const RAYS = 1;
        /// Shades these hits without tracing rays.
        const SHADING = 1 << 1;
        /// Shades these hits and traces rays.
        const TRACED_SHADING = 1 << 2;
        /// Shades these hits, and also traces rays of exact mirrors.
        const SHADING_AND_MIRRORS = 1 << 3;
        /// Traces rays of exact mirrors and shades their hits.
        const MIRRORS = 1 << 4;
        /// Traces and shades one ray per pixel.
        const CONVERGED = 1 << 5;
        /// Traces and shades rays of fragments.
        const INLINE = 1 << 6;
        /// Finds the front layer.
        const FRONT_LAYER = 1 << 7;

        /// All passes that both trace and shade hits.
        const SHADED_RAYS =
            Self::SHADING_AND_MIRRORS.bits() | Self::MIRRORS.bits() | Self::CONVERGED.bits() | Self::INLINE.bits();
        /// All passes that shade hits.
        const ALL_SHADING = Self::SHADING.bits() | Self::TRACED_SHADING.bits() | Self::SHADED_RAYS.bits();
        /// All passes that trace rays from the surfaces of a view.
        const FIRST_RAYS = Self::RAYS.bits() | Self::SHADED_RAYS.bits();
        /// All passes that trace reflection rays, or shadow rays.
        const ALL_TRACING = Self::FIRST_RAYS.bits() | Self::TRACED_SHADING.bits();
    }
}

/// A feature, its definition, and the passes that use it.
struct Row {
    feature: Features,
    definition: &'static str,
    passes: Passes,
}

const fn row(feature: Features, definition: &'static str, passes: Passes) -> Row {
    Row {
        feature,
        definition,
        passes,
    }
}

/// All features. The definitions of the first two depend on the tracer (`SceneBindings::definitions`).
const TABLE: [Row; 28] = {
    use Features as F;
    use Passes as P;
    [
        row(F::MASKED, "", P::all()),
        row(F::DEEP_TREES, "", P::ALL_TRACING.union(P::FRONT_LAYER)),
        row(F::RENDER_LAYERS, "RENDER_LAYERS", P::ALL_TRACING.union(P::FRONT_LAYER)),
        row(F::TINTS, "TINTED_GLASS", P::ALL_TRACING.union(P::SHADING)),
        row(F::LAYERS, "LAYERED_RAYS", P::MIRRORS.union(P::CONVERGED)),
        row(
            F::REFRACTION,
            "REFRACTION",
            P::FIRST_RAYS.difference(P::SHADING_AND_MIRRORS),
        ),
        row(F::LIGHT_PROBES, "LIGHT_PROBES", P::ALL_TRACING.union(P::SHADING)),
        row(F::LIGHT_SAMPLING, "LIGHT_SAMPLING", P::ALL_TRACING),
        row(F::MANY_LIGHTS, "MANY_LIGHTS", P::TRACED_SHADING),
        row(F::ATMOSPHERE, "ATMOSPHERIC", P::ALL_TRACING.union(P::SHADING)),
        row(F::HAZE, "AERIAL_PERSPECTIVE", P::ALL_SHADING),
        row(F::LIGHTMAPS, "LIGHTMAPS", P::ALL_SHADING),
        row(F::CLEARCOAT, "CLEARCOAT", P::ALL_SHADING),
        row(
            F::DIFFUSE_TRANSMISSION,
            "DIFFUSE_TRANSMISSION",
            P::ALL_TRACING.union(P::SHADING),
        ),
        row(F::RECT_LIGHTS, "RECT_LIGHTS", P::ALL_SHADING),
        row(F::LIGHT_TEXTURES, "LIGHT_TEXTURES", P::ALL_SHADING),
        row(F::FOG_VOLUMES, "VOLUMETRIC_FOG", P::ALL_TRACING),
        row(F::FOG_DENSITY, "FOG_DENSITY", P::ALL_TRACING),
        row(F::FORWARD_SURFACES, "FORWARD_SURFACES", P::FRONT_LAYER),
        row(F::SURFACE_SHADER, "SURFACE_SHADER", P::ALL_SHADING),
        row(F::BOUNCES, "BOUNCES", P::ALL_SHADING),
        row(F::SCREEN_TRACES, "SCREEN_TRACES", P::FIRST_RAYS),
        row(F::SCREEN_MARCH, "SCREEN_MARCH", P::FIRST_RAYS),
        row(F::COPLANAR, "COPLANAR", P::ALL_TRACING),
        row(F::PARTICLES, "PARTICLES", P::ALL_TRACING.union(P::SHADING)),
        row(F::LIT_PARTICLES, "LIT_PARTICLES", P::ALL_TRACING),
        row(F::DECALS, "DECALS", P::ALL_SHADING.union(P::FRONT_LAYER)),
        row(F::SPECULAR_TINT, "SPECULAR_TINT", P::ALL_SHADING),
    ]
};

/// A compiled variant of a pass to use in place of the requested one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fit {
    pub features: Features,
    /// Requested features that it lacks.
    pub missing: Features,
}

impl Features {
    /// Features that depend on a view's settings. Bindings depend on them too, so a variant must match them exactly.
    const SETTINGS: Self = Self::BOUNCES.union(Self::SCREEN_TRACES).union(Self::SCREEN_MARCH);
    /// Features without which rays go wrong; without the others, hits only lack some light. A variant with `LIGHT_SAMPLING` is as bad if
    /// the feature isn't requested: outside of the light tree, hits only see directional lights.
    const GRAVE: Self = Self::MASKED
        .union(Self::DEEP_TREES)
        .union(Self::RENDER_LAYERS)
        .union(Self::LIGHT_SAMPLING);
    /// Features that a variant can have without a request: they then have no effect.
    pub(crate) const HARMLESS: Self = Self::all().difference(Self::SETTINGS).difference(Self::SURFACE_SHADER);
    /// All features of the raw Vulkan pass, in any scene on a device that supports light probes.
    pub(crate) const OF_VRS: Self = Self::LIGHTMAPS
        .union(Self::CLEARCOAT)
        .union(Self::ATMOSPHERE)
        .union(Self::RECT_LIGHTS)
        .union(Self::LIGHT_TEXTURES)
        .union(Self::DIFFUSE_TRANSMISSION)
        .union(Self::LIGHT_PROBES);

    /// Features that depend on a view's settings.
    pub(crate) fn asked_by(settings: &ClampedSettings) -> Self {
        let asked = [
            (settings.has_bounces(), Self::BOUNCES),
            (settings.reuses_screen(), Self::SCREEN_TRACES),
            (settings.marches_screen(), Self::SCREEN_MARCH),
        ];
        asked
            .into_iter()
            .filter_map(|(is_asked, feature)| is_asked.then_some(feature))
            .collect()
    }

    /// Features that an app will need later.
    pub(crate) fn of_warm_up(warm_up: &ReflectionWarmUp) -> Self {
        let see_through = Self::MASKED | Self::TINTS | Self::LAYERS | Self::REFRACTION | Self::COPLANAR;
        let named = [
            (warm_up.see_through, see_through),
            (warm_up.light_probes, Self::LIGHT_PROBES),
            (warm_up.lightmaps, Self::LIGHTMAPS),
            (warm_up.clearcoat, Self::CLEARCOAT),
            (warm_up.specular_tint, Self::SPECULAR_TINT),
            (warm_up.diffuse_transmission, Self::DIFFUSE_TRANSMISSION),
            (warm_up.rect_lights, Self::RECT_LIGHTS),
            (warm_up.light_textures, Self::LIGHT_TEXTURES),
            (warm_up.many_lights, Self::MANY_LIGHTS | Self::LIGHT_SAMPLING),
            (warm_up.atmosphere, Self::ATMOSPHERE | Self::HAZE),
            (
                warm_up.volumetric_fog,
                Self::MANY_LIGHTS | Self::FOG_VOLUMES | Self::FOG_DENSITY,
            ),
            (
                warm_up.particles,
                Self::MANY_LIGHTS | Self::PARTICLES | Self::LIT_PARTICLES,
            ),
            (warm_up.decals, Self::DECALS),
        ];
        named
            .into_iter()
            .filter_map(|(is_named, features)| is_named.then_some(features))
            .collect()
    }

    /// The features that affect a pass.
    pub(crate) fn seen_by(self, pass: Passes) -> Self {
        let seen: Self = TABLE
            .iter()
            .filter(|row| row.passes.intersects(pass))
            .map(|row| row.feature)
            .collect();
        let seen = self & seen;
        if pass == Passes::SHADING {
            // The pass traces no rays, so one pipeline serves scenes with and without masks.
            seen | Self::MASKED
        } else if self.contains(Self::MASKED) {
            seen
        } else {
            seen - Self::LAYERS - Self::REFRACTION
        }
    }

    /// Names of the definitions that don't depend on the tracer.
    pub(crate) fn definitions(self) -> impl Iterator<Item = &'static str> {
        let rows = TABLE.iter().filter(move |row| self.contains(row.feature));
        rows.map(|row| row.definition).filter(|name| !name.is_empty())
    }

    /// Returns the compiled variant that lacks the fewest requested features; `None` if there is none for the view's settings. It can have
    /// unrequested features out of `spare`, so that no other feature disappears while shaders are compiled for one that came or went.
    pub(crate) fn best_of(self, compiled: impl IntoIterator<Item = Self>, spare: Self) -> Option<Fit> {
        let fit = |features: Self| Fit {
            features,
            missing: self.difference(features) | (features.difference(self) & Self::LIGHT_SAMPLING),
        };
        let count = |features: Self| features.bits().count_ones();
        compiled
            .into_iter()
            .filter(|features| !(*features ^ self).intersects(Self::SETTINGS))
            .filter(|features| spare.contains(features.difference(self)))
            .map(fit)
            .min_by_key(|fit| {
                let spare = count(fit.features.difference(self));
                (fit.loss(), spare, fit.features.bits())
            })
    }
}

impl Fit {
    /// Ranks a variant by the features that it lacks, first by those without which rays go wrong.
    pub fn loss(self) -> (u32, u32) {
        let grave = self.missing & Features::GRAVE;
        (grave.bits().count_ones(), self.missing.bits().count_ones())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{RayTracedReflections, ScreenTraces};

    const RICH: Features = Features::MASKED
        .union(Features::ATMOSPHERE)
        .union(Features::LIGHTMAPS)
        .union(Features::LIGHT_PROBES);

    fn best(wanted: Features, compiled: &[Features]) -> Option<Features> {
        let fit = wanted.best_of(compiled.iter().copied(), Features::HARMLESS);
        fit.map(|fit| fit.features)
    }

    #[test]
    fn all_features_have_a_row_and_a_definition_of_their_own() {
        let rows: Features = TABLE.iter().map(|row| row.feature).collect();
        assert_eq!(rows, Features::all());
        let names: std::collections::BTreeSet<_> = Features::all().definitions().collect();
        assert_eq!(names.len(), TABLE.len() - 2);
    }

    #[test]
    fn a_new_feature_takes_no_other_one_away() {
        let wanted = RICH | Features::RECT_LIGHTS;
        let compiled = [Features::MASKED, Features::MASKED | Features::ATMOSPHERE, RICH];
        assert_eq!(best(wanted, &compiled), Some(RICH));
        let fit = wanted.best_of(compiled, Features::HARMLESS);
        assert_eq!(fit.map(|fit| fit.missing), Some(Features::RECT_LIGHTS));
        assert_eq!(best(wanted, &[RICH, wanted]), Some(wanted));
        // The richer variant is used if only that was ever compiled, and nothing turns black.
        assert_eq!(best(wanted, &[RICH]), Some(RICH));
        assert_eq!(best(wanted, &[]), None);
    }

    #[test]
    fn a_feature_that_goes_takes_no_other_one_with_it() {
        let wanted = RICH - Features::LIGHT_PROBES;
        let fit = wanted.best_of([Features::MASKED, RICH], Features::HARMLESS).unwrap();
        assert_eq!((fit.features, fit.missing), (RICH, Features::empty()));
        // One feature goes, another one comes.
        let other = wanted | Features::CLEARCOAT;
        assert_eq!(best(other, &[Features::MASKED, RICH]), Some(RICH));
        // Of the complete variants, the one with the fewest features.
        assert_eq!(best(wanted, &[RICH | Features::HAZE, RICH]), Some(RICH));
    }

    #[test]
    fn masks_matter_more_than_light() {
        let unmasked = (RICH | Features::CLEARCOAT) - Features::MASKED;
        assert_eq!(best(RICH, &[unmasked, Features::MASKED]), Some(Features::MASKED));
        assert_eq!(best(RICH, &[unmasked]), Some(unmasked));
        // A shader for masks also works in scenes without them.
        assert_eq!(best(unmasked - Features::CLEARCOAT, &[RICH]), Some(RICH));
    }

    #[test]
    fn the_settings_of_a_view_are_never_left_out() {
        let of = |settings: RayTracedReflections| Features::asked_by(&ClampedSettings::from(&settings));
        let default = RayTracedReflections::default;
        assert_eq!(of(default()), Features::empty());
        let bounces = of(RayTracedReflections {
            max_bounces: 2,
            ..default()
        });
        assert_eq!(bounces, Features::BOUNCES);
        let screen = |screen_traces| {
            of(RayTracedReflections {
                screen_traces,
                ..default()
            })
        };
        assert!(screen(ScreenTraces::Reuse).definitions().eq(["SCREEN_TRACES"]));
        let marching = screen(ScreenTraces::March);
        assert!(marching.definitions().eq(["SCREEN_TRACES", "SCREEN_MARCH"]));
        for asked in [bounces, screen(ScreenTraces::Reuse), marching] {
            assert_eq!(best(RICH | asked, &[RICH]), None);
            assert_eq!(best(RICH, &[RICH | asked]), None);
            assert_eq!(
                best(RICH | asked, &[Features::MASKED | asked]),
                Some(Features::MASKED | asked)
            );
        }
    }

    #[test]
    fn the_apps_shader_can_be_left_out_and_runs_only_while_it_is_there() {
        let own = RICH | Features::SURFACE_SHADER;
        assert_eq!(best(own, &[Features::MASKED, RICH]), Some(RICH));
        assert_eq!(best(RICH, &[own]), None);
    }

    #[test]
    fn shaders_that_draw_lights_are_the_last_choice_where_no_tree_has_them() {
        let drawing = RICH | Features::LIGHT_SAMPLING;
        let fit = RICH.best_of([drawing], Features::HARMLESS).unwrap();
        assert_eq!(fit.missing, Features::LIGHT_SAMPLING);
        assert_eq!(best(RICH, &[drawing, Features::MASKED]), Some(Features::MASKED));
    }

    #[test]
    fn passes_see_only_what_makes_a_difference_to_them() {
        let seen = |pass| Features::all().seen_by(pass);
        let rays = seen(Passes::RAYS);
        assert!(!rays.intersects(
            Features::LIGHTMAPS | Features::DECALS | Features::HAZE | Features::RECT_LIGHTS | Features::BOUNCES
        ));
        assert!(rays.contains(Features::REFRACTION | Features::DIFFUSE_TRANSMISSION | Features::SCREEN_TRACES));
        // The ray pass needs it in order to test only directional lights.
        assert!(rays.contains(Features::LIGHT_SAMPLING));
        let plain = seen(Passes::SHADING);
        assert!(plain.contains(Features::LIGHTMAPS | Features::HAZE | Features::ATMOSPHERE | Features::TINTS));
        assert!(!plain.intersects(Features::LIGHT_SAMPLING | Features::FOG_VOLUMES | Features::SCREEN_TRACES));
        let traced = seen(Passes::TRACED_SHADING);
        assert!(traced.contains(Features::MANY_LIGHTS | Features::LIGHT_SAMPLING | Features::FOG_VOLUMES));
        assert!(!traced.intersects(Features::SCREEN_TRACES | Features::LAYERS | Features::REFRACTION));
        let find = seen(Passes::FRONT_LAYER);
        let of_find = Features::MASKED
            | Features::DEEP_TREES
            | Features::RENDER_LAYERS
            | Features::FORWARD_SURFACES
            | Features::DECALS;
        assert_eq!(find, of_find);
        // Rays pass through nothing if there are no masks.
        let opaque = Features::all() - Features::MASKED;
        let bent = Features::LAYERS | Features::REFRACTION;
        assert!(!opaque.seen_by(Passes::MIRRORS).intersects(bent));
        assert!(seen(Passes::MIRRORS).contains(bent));
    }
}
