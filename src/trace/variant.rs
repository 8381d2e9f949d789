//! The passes that trace rays, and what their shaders are compiled for.

use crate::{
    scene::SceneBindings,
    settings::{ClampedSettings, ReflectionBackend, ReflectionTechnique},
};

/// A pass that traces rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum TracePass {
    /// One thread for each block of the ray list.
    Blocks,
    /// One thread for each pixel of the mirror ray list.
    Mirrors,
    /// One fragment for each trace pixel.
    Inline,
    /// One thread for each pixel, into the accumulation.
    Converged,
}

impl TracePass {
    /// The passes that a view's settings need.
    pub fn of(settings: &ClampedSettings) -> impl Iterator<Item = Self> + use<> {
        let mirrors = settings.full_resolution_mirrors.then_some(Self::Mirrors);
        [Some(Self::of_rays(settings)), mirrors].into_iter().flatten()
    }

    fn of_rays(settings: &ClampedSettings) -> Self {
        match settings.technique {
            ReflectionTechnique::Converged => Self::Converged,
            ReflectionTechnique::QuarterInline => Self::Inline,
            ReflectionTechnique::Reference | ReflectionTechnique::Quarter | ReflectionTechnique::Variable => {
                Self::Blocks
            }
        }
    }

    /// Returns whether a view has mirror rays that may be traced beside the shading of its blocks' hits.
    pub fn may_join_mirrors(settings: &ClampedSettings) -> bool {
        settings.full_resolution_mirrors
            && Self::of_rays(settings) == Self::Blocks
            && settings.backend != ReflectionBackend::HardwareVrs
            && !settings.has_bounces()
    }
}

/// Features that a view's settings ask of the shaders of its passes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Asked {
    /// Rays are followed beyond their first hit.
    bounces: bool,
    /// Hits take light from what the camera showed.
    reuses_screen: bool,
    /// Rays find more there than they hit.
    marches: bool,
}

impl Asked {
    pub fn by(settings: &ClampedSettings) -> Self {
        Self {
            bounces: settings.has_bounces(),
            reuses_screen: settings.reuses_screen(),
            marches: settings.marches_screen(),
        }
    }
}

/// Conditions that shaders are compiled for: properties of the scene, and of the view's settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Variant {
    /// Some object is alpha-masked.
    pub masked: bool,
    /// The scene's trees need a larger stack.
    pub deep: bool,
    /// Some object has a lightmap.
    pub lightmaps: bool,
    /// Rays are followed beyond their first hit.
    pub bounces: bool,
    /// Hits take light from what the camera showed.
    pub reuses_screen: bool,
    /// Rays find more there than they hit.
    pub marches: bool,
    /// Some object tints the light that it lets through.
    pub tinted: bool,
    /// Rays of exact mirrors are followed through see-through surfaces without chance.
    pub layered: bool,
    /// First rays are refracted by glass.
    pub refracts: bool,
    /// Some material has a clearcoat.
    pub clearcoat: bool,
    /// There are light probes.
    pub probes: bool,
    /// Not all cameras see the same objects.
    pub layers: bool,
    /// Hits draw some of the lights.
    pub draws_lights: bool,
    /// Some view lies in an atmosphere.
    pub air: bool,
    /// Its haze lies before what rays hit.
    pub haze: bool,
    /// The app's shader changes the surfaces of hits.
    pub own_surfaces: bool,
    /// There are rectangular lights.
    pub rects: bool,
    /// Some light has a texture.
    pub light_textures: bool,
    /// Diffuse light comes through some material.
    pub translucent: bool,
    /// Some view shows volumes of fog.
    pub volumes: bool,
    /// Some of them have a texture of their density.
    pub fog_density: bool,
}

/// Conditions that the shading of hits is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum ShadingVariant {
    /// It traces no rays.
    Plain {
        lightmaps: bool,
        tinted: bool,
        clearcoat: bool,
        probes: bool,
        air: bool,
        haze: bool,
        own_surfaces: bool,
        rects: bool,
        light_textures: bool,
        translucent: bool,
    },
    /// It traces rays itself: in scenes with more lights than the tracing pass has tested (`trace/hit.wesl`), and where rays are
    /// followed beyond their first hit.
    Tracing(Variant),
}

impl Variant {
    /// The variant that fits the scene.
    pub fn of(scene: &SceneBindings) -> Self {
        Self {
            masked: scene.has_masked_geometry(),
            deep: scene.has_deep_trees(),
            lightmaps: scene.has_lightmaps(),
            bounces: false,
            reuses_screen: false,
            marches: false,
            layered: false,
            refracts: false,
            tinted: scene.see_through.has_tints(),
            clearcoat: scene.has_clearcoat(),
            probes: scene.has_light_probes(),
            layers: scene.has_render_layers(),
            draws_lights: scene.draws_lights(),
            air: scene.has_air(),
            haze: scene.has_haze(),
            own_surfaces: false,
            rects: scene.has_rect_lights(),
            light_textures: scene.has_light_textures(),
            translucent: scene.has_diffuse_transmission(),
            volumes: scene.has_fog_volumes(),
            fog_density: scene.has_fog_density(),
        }
    }

    /// The same for what a view asks for.
    pub fn with(self, asked: Asked) -> Self {
        Self {
            bounces: asked.bounces,
            reuses_screen: asked.reuses_screen,
            marches: asked.marches,
            ..self
        }
    }

    /// The same for rays that another pass shades, and follows beyond their first hit.
    pub fn without_shading(self) -> Self {
        Self {
            lightmaps: false,
            clearcoat: false,
            haze: false,
            own_surfaces: false,
            rects: false,
            light_textures: false,
            bounces: false,
            ..self
        }
    }

    /// Definitions for all passes.
    pub fn defs(self) -> impl Iterator<Item = &'static str> {
        let defs = [
            (self.tinted, "TINTED_GLASS"),
            (self.layered, "LAYERED_RAYS"),
            (self.refracts, "REFRACTION"),
            (self.probes, "LIGHT_PROBES"),
            (self.layers, "RENDER_LAYERS"),
            (self.draws_lights, "LIGHT_SAMPLING"),
            (self.air, "ATMOSPHERIC"),
            (self.translucent, "DIFFUSE_TRANSMISSION"),
            (self.volumes, "VOLUMETRIC_FOG"),
            (self.fog_density, "FOG_DENSITY"),
            (self.reuses_screen, "SCREEN_TRACES"),
            (self.marches, "SCREEN_MARCH"),
        ];
        defs.into_iter().filter_map(|(set, name)| set.then_some(name))
    }

    /// Definitions for passes that shade hits.
    pub fn shading_defs(self) -> Vec<&'static str> {
        let defs = [
            (self.lightmaps, "LIGHTMAPS"),
            (self.clearcoat, "CLEARCOAT"),
            (self.haze, "AERIAL_PERSPECTIVE"),
            (self.rects, "RECT_LIGHTS"),
            (self.light_textures, "LIGHT_TEXTURES"),
            (self.bounces, "BOUNCES"),
            (self.own_surfaces, "SURFACE_SHADER"),
        ];
        defs.into_iter().filter_map(|(set, name)| set.then_some(name)).collect()
    }

    /// The same for the shading of hits for which the pass that traced them found no light on the screen.
    pub fn without_screen(self) -> Self {
        Self {
            reuses_screen: false,
            marches: false,
            ..self
        }
    }

    /// The shading of hits alone.
    pub fn plain(self) -> ShadingVariant {
        ShadingVariant::Plain {
            lightmaps: self.lightmaps,
            tinted: self.tinted,
            clearcoat: self.clearcoat,
            probes: self.probes,
            air: self.air,
            haze: self.haze,
            own_surfaces: self.own_surfaces,
            rects: self.rects,
            light_textures: self.light_textures,
            translucent: self.translucent,
        }
    }

    /// Without what only adds to the light of hits, and without the app's shader.
    fn dark(self) -> Self {
        Self {
            lightmaps: false,
            clearcoat: false,
            probes: false,
            draws_lights: false,
            air: false,
            haze: false,
            own_surfaces: false,
            rects: false,
            light_textures: false,
            translucent: false,
            volumes: false,
            fog_density: false,
            ..self
        }
    }

    fn clear(self) -> Self {
        Self { tinted: false, ..self }
    }

    fn straight(self) -> Self {
        Self {
            refracts: false,
            ..self
        }
    }

    /// Itself, the one that is right for all scenes of such trees, and others that are better than nothing while these are
    /// compiled: they leave out the app's shader, baked light, clearcoats, light probes, the atmosphere, rectangular lights, textures
    /// of lights, light that comes through, volumes of fog, lights that are drawn, tints or refraction, follow rays through see-through
    /// surfaces by chance, or miss hits where the stack is full and show what another camera sees.
    pub fn substitutes(self) -> [Self; 10] {
        let masked = Self { masked: true, ..self };
        let known = |variant: Self| Self {
            own_surfaces: false,
            ..variant
        };
        let plain = Self {
            layered: false,
            refracts: false,
            ..masked.dark().clear()
        };
        let shallow = Self {
            deep: false,
            layers: false,
            ..plain
        };
        [
            self,
            masked,
            known(self),
            known(masked),
            Self {
                fog_density: false,
                ..masked
            },
            masked.dark(),
            known(masked.clear()),
            known(masked.clear().straight()),
            plain,
            shallow,
        ]
    }

    /// The same for the shading of hits: the last ones leave out lights. None leaves out bounces, which a converging picture would
    /// keep.
    pub fn shading_substitutes(self, many_lights: bool) -> impl Iterator<Item = ShadingVariant> {
        let traces = many_lights || self.bounces;
        let whole = self.without_screen();
        let all = traces.then_some(whole.substitutes()).into_iter().flatten();
        let known = Self {
            own_surfaces: false,
            ..whole
        };
        let even = Self {
            fog_density: false,
            ..known
        };
        let plain = [whole, known, even, known.dark(), known.clear(), known.clear().dark()].map(Self::plain);
        let plain = (!self.bounces).then_some(plain).into_iter().flatten();
        all.map(ShadingVariant::Tracing).chain(plain)
    }
}

impl ShadingVariant {
    /// The app's shader changes the surfaces of hits.
    pub fn has_own_surfaces(self) -> bool {
        let (Self::Plain { own_surfaces, .. } | Self::Tracing(Variant { own_surfaces, .. })) = self;
        own_surfaces
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{RayTracedReflections, ScreenTraces};

    #[test]
    fn one_bounce_gets_the_shaders_without_bounces() {
        let variant = |max_bounces| {
            let settings = RayTracedReflections {
                max_bounces,
                ..Default::default()
            };
            Variant::default().with(Asked::by(&ClampedSettings::from(&settings)))
        };
        assert_eq!(variant(1), Variant::default());
        let plain = Variant::default().plain();
        assert!(variant(1).shading_substitutes(false).all(|variant| variant == plain));
        for many_lights in [false, true] {
            let mut shading = variant(2).shading_substitutes(many_lights);
            assert!(shading.all(|variant| matches!(variant, ShadingVariant::Tracing(variant) if variant.bounces)));
        }
        assert!(variant(8).substitutes().iter().all(|variant| variant.bounces));
    }

    #[test]
    fn mirrors_join_the_shading_of_blocks_alone() {
        let joins = |settings: RayTracedReflections| TracePass::may_join_mirrors(&ClampedSettings::from(&settings));
        let default = RayTracedReflections::default;
        assert!(joins(default()));
        for technique in [ReflectionTechnique::QuarterInline, ReflectionTechnique::Converged] {
            assert!(!joins(RayTracedReflections { technique, ..default() }), "{technique:?}");
        }
        for (backend, expected) in [
            (ReflectionBackend::Auto, true),
            (ReflectionBackend::Compute, true),
            (ReflectionBackend::HardwareVrs, false),
        ] {
            assert_eq!(
                joins(RayTracedReflections { backend, ..default() }),
                expected,
                "{backend:?}"
            );
        }
        let bouncing = RayTracedReflections {
            max_bounces: 2,
            ..default()
        };
        assert!(!joins(bouncing));
        let without = RayTracedReflections {
            full_resolution_mirrors: false,
            ..default()
        };
        assert!(!joins(without));
    }

    #[test]
    fn lights_are_drawn_by_shaders_that_trace_and_only_where_the_scene_asks_for_it() {
        let variant = Variant {
            draws_lights: true,
            ..Variant::default()
        };
        assert!(variant.defs().eq(["LIGHT_SAMPLING"]));
        assert_eq!(Variant::default().defs().count(), 0);
        // The rays' pass must know that it tests directional lights alone.
        assert!(variant.without_shading().draws_lights);
        let mut shading = variant.shading_substitutes(true);
        assert_eq!(shading.next(), Some(ShadingVariant::Tracing(variant)));
        assert_eq!(shading.last(), Some(Variant::default().plain()));
        let layered = Variant {
            layered: true,
            ..Variant::default()
        };
        assert!(layered.defs().eq(["LAYERED_RAYS"]));
        assert!(layered.substitutes()[..2].iter().all(|variant| variant.layered));
        assert!(
            !layered.substitutes()[8].layered,
            "it is not compiled while the scene has nothing to see through"
        );
        let refracting = Variant {
            refracts: true,
            ..Variant::default()
        };
        assert!(refracting.defs().eq(["REFRACTION"]));
        assert!(refracting.substitutes()[..2].iter().all(|variant| variant.refracts));
        assert!(refracting.substitutes()[7..].iter().all(|variant| !variant.refracts));
        // The first two leave out nothing, which `TracePipelines::is_complete` counts on.
        assert!(variant.substitutes()[..2].iter().all(|variant| variant.draws_lights));
    }

    #[test]
    fn passes_that_trace_first_hits_know_the_screen() {
        let settings = RayTracedReflections {
            screen_traces: ScreenTraces::Reuse,
            ..Default::default()
        };
        let variant = Variant::default().with(Asked::by(&ClampedSettings::from(&settings)));
        assert!(variant.defs().eq(["SCREEN_TRACES"]));
        assert_eq!(variant.shading_defs().len(), 0);
        assert!(variant.without_shading().reuses_screen);
        // Its bindings are others, so that none without stands in.
        assert!(variant.substitutes().iter().all(|variant| variant.reuses_screen));
        let plain = Variant::default().plain();
        assert!(variant.shading_substitutes(false).all(|variant| variant == plain));
        let mut shading = variant.shading_substitutes(true);
        assert_eq!(shading.next(), Some(ShadingVariant::Tracing(Variant::default())));
        let settings = RayTracedReflections {
            screen_traces: ScreenTraces::March,
            ..settings
        };
        let marching = Variant::default().with(Asked::by(&ClampedSettings::from(&settings)));
        assert!(marching.defs().eq(["SCREEN_TRACES", "SCREEN_MARCH"]));
        assert!(marching.substitutes().iter().all(|variant| variant.marches));
        assert_eq!(marching.without_screen(), Variant::default());
    }

    #[test]
    fn rays_that_miss_and_hits_know_the_atmosphere() {
        let variant = Variant {
            air: true,
            ..Variant::default()
        };
        assert!(variant.defs().eq(["ATMOSPHERIC"]));
        assert!(variant.without_shading().air);
        assert_eq!(variant.shading_substitutes(false).next(), Some(variant.plain()));
        assert_eq!(
            variant.shading_substitutes(false).last(),
            Some(Variant::default().plain())
        );
        assert!(variant.substitutes()[..2].iter().all(|variant| variant.air));
    }

    #[test]
    fn haze_is_known_where_hits_are_shaded() {
        let variant = Variant {
            air: true,
            haze: true,
            ..Variant::default()
        };
        assert!(variant.defs().eq(["ATMOSPHERIC"]));
        assert_eq!(variant.shading_defs(), ["AERIAL_PERSPECTIVE"]);
        let rays = variant.without_shading();
        assert!(rays.air && !rays.haze);
        assert_eq!(variant.shading_substitutes(false).next(), Some(variant.plain()));
        assert!(variant.substitutes()[..2].iter().all(|variant| variant.haze));
    }

    #[test]
    fn light_that_comes_through_is_known_to_rays_that_test_lights() {
        let variant = Variant {
            translucent: true,
            ..Variant::default()
        };
        assert!(variant.defs().eq(["DIFFUSE_TRANSMISSION"]));
        assert!(variant.without_shading().translucent);
        assert_eq!(variant.shading_substitutes(false).next(), Some(variant.plain()));
        assert!(variant.substitutes()[..2].iter().all(|variant| variant.translucent));
    }

    #[test]
    fn lightmaps_are_left_out_last_and_only_by_shaders_that_shade() {
        let variant = Variant {
            lightmaps: true,
            ..Variant::default()
        };
        assert_eq!(variant.shading_defs(), ["LIGHTMAPS"]);
        assert_eq!(variant.without_shading(), Variant::default());
        let coated = Variant {
            clearcoat: true,
            ..variant
        };
        assert_eq!(coated.shading_defs(), ["LIGHTMAPS", "CLEARCOAT"]);
        let in_rectangles = Variant {
            rects: true,
            ..Variant::default()
        };
        assert_eq!(in_rectangles.shading_defs(), ["RECT_LIGHTS"]);
        assert_eq!(in_rectangles.without_shading(), Variant::default());
        let in_textures = Variant {
            light_textures: true,
            ..Variant::default()
        };
        assert_eq!(in_textures.shading_defs(), ["LIGHT_TEXTURES"]);
        assert_eq!(in_textures.without_shading(), Variant::default());
        assert_eq!(coated.without_shading(), Variant::default());
        assert_eq!(
            coated.shading_substitutes(false).last(),
            Some(Variant::default().plain())
        );
        let mut shading = variant.shading_substitutes(false);
        assert_eq!(shading.next(), Some(variant.plain()));
        assert_eq!(shading.last(), Some(Variant::default().plain()));
        let first_dark = variant.substitutes().iter().position(|variant| !variant.lightmaps);
        assert_eq!(first_dark, Some(5));
    }

    #[test]
    fn the_apps_shader_runs_where_hits_are_shaded_and_can_be_left_out() {
        let variant = Variant {
            own_surfaces: true,
            ..Variant::default()
        };
        assert_eq!(variant.shading_defs(), ["SURFACE_SHADER"]);
        assert_eq!(variant.without_shading(), Variant::default());
        for many_lights in [false, true] {
            let own: Vec<bool> = variant
                .shading_substitutes(many_lights)
                .map(ShadingVariant::has_own_surfaces)
                .collect();
            assert!(own[0] && !own[own.len() - 1], "{own:?}");
        }
        assert!(variant.substitutes()[..2].iter().all(|variant| variant.own_surfaces));
        // A scene with more than the least shows the rest where the app's shader fails.
        let bright = Variant {
            rects: true,
            lightmaps: true,
            ..variant
        };
        assert_eq!(
            bright.substitutes()[2],
            Variant {
                own_surfaces: false,
                ..bright
            }
        );
    }

    #[test]
    fn hits_without_tints_are_never_shaded_with_them() {
        let variants = [
            Variant::default(),
            Variant {
                tinted: true,
                ..Variant::default()
            },
        ];
        for (variant, many_lights) in variants.into_iter().zip([false, true]) {
            let clear = Variant {
                tinted: false,
                ..variant
            };
            for shading in clear.shading_substitutes(many_lights) {
                let (ShadingVariant::Plain { tinted, .. } | ShadingVariant::Tracing(Variant { tinted, .. })) = shading;
                assert!(!tinted, "{shading:?}");
            }
        }
    }
}
