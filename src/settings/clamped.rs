//! Settings of a camera, clamped to the ranges that the shaders support.

use super::{
    RayTracedReflections, ReflectionBackend, ReflectionDenoiser, ReflectionSampling, ReflectionTechnique,
    ReflectionTextureMip, ScreenTraces, reflections::PAPER_LEVEL,
};

/// Bound of the loop over bounces; `trace/bounce.wesl` has the same number.
const MAX_BOUNCES: u32 = 8;

/// [`RayTracedReflections`] within its ranges. NaN becomes the default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClampedSettings {
    pub technique: ReflectionTechnique,
    pub backend: ReflectionBackend,
    pub sampling: ReflectionSampling,
    pub full_resolution_mirrors: bool,
    pub denoiser: ReflectionDenoiser,
    pub fade_start: f32,
    /// Halfway between two roughnesses that a G-buffer can store, so that no roughness ever equals it.
    pub cutoff: f32,
    pub max_ray_length: f32,
    pub max_bounces: u32,
    pub bounce_cutoff: f32,
    pub screen_traces: ScreenTraces,
    pub shadow_rays: bool,
    /// `None` for ray cones.
    pub fixed_mip: Option<f32>,
    pub transparent: bool,
    pub forward: bool,
    /// Reconstruction and accumulation are separate passes, since a debug view shows the data between them, or nothing is accumulated.
    pub separate_denoiser: bool,
}

/// The border between the last step of 1/255 that `cutoff` includes and the next: Bevy's lighting and ours must agree on each pixel.
pub(super) fn between_steps(cutoff: f32) -> f32 {
    ((cutoff * 255.0 + 1e-3).floor() + 0.5) / 255.0
}

/// `value`, or the default for NaN.
pub(super) fn number_or(value: f32, default: f32) -> f32 {
    if value.is_nan() { default } else { value }
}

impl ClampedSettings {
    /// Returns whether rays are traced beyond their first hit.
    pub fn has_bounces(&self) -> bool {
        self.max_bounces > 1
    }

    /// Returns whether surfaces that Bevy draws in its forward pass reflect.
    pub fn has_front_layer(&self) -> bool {
        self.transparent || self.forward
    }

    /// Returns whether hits take light from the last frame. The ground truth shades all of them, and so do rays from fragment shaders,
    /// which few cameras use.
    pub fn reuses_screen(&self) -> bool {
        self.screen_traces != ScreenTraces::Off && can_reuse_screen(self.technique, self.backend)
    }

    /// Returns whether rays of earlier frames are traced again. The screen's light has the noise of its frame, which would count as a change.
    pub fn follows_light(&self) -> bool {
        self.denoiser.follow_light_changes
            && self.denoiser.temporal
            && self.technique != ReflectionTechnique::Converged
            && !self.reuses_screen()
    }

    /// Returns whether reconstruction and accumulation are one pass, without data in between.
    pub fn denoises_in_one_pass(&self) -> bool {
        self.denoiser.temporal
            && self.technique != ReflectionTechnique::Converged
            && self.technique.trace_scale() > 1
            && !self.separate_denoiser
    }

    /// Pixels per texel of the denoiser in each direction: 1 or 2.
    pub fn texel(&self) -> u32 {
        if self.denoiser.half_resolution { 2 } else { 1 }
    }

    /// Returns whether rays also march the last frame's screen.
    pub fn marches_screen(&self) -> bool {
        self.screen_traces == ScreenTraces::March && self.reuses_screen()
    }
}

/// Returns whether rays of this technique and back end can take light from the screen.
pub(crate) fn can_reuse_screen(technique: ReflectionTechnique, backend: ReflectionBackend) -> bool {
    let has_lists = match technique {
        ReflectionTechnique::Reference | ReflectionTechnique::Quarter | ReflectionTechnique::Variable => true,
        ReflectionTechnique::QuarterInline | ReflectionTechnique::Converged => false,
    };
    has_lists && backend != ReflectionBackend::HardwareVrs
}

impl From<&RayTracedReflections> for ClampedSettings {
    fn from(settings: &RayTracedReflections) -> Self {
        let default = RayTracedReflections::default();
        let cutoff = number_or(settings.roughness_cutoff, default.roughness_cutoff).clamp(0.0, 1.0);
        let fade = number_or(settings.roughness_fade, default.roughness_fade).clamp(0.0, 1.0);
        Self {
            technique: settings.technique,
            backend: settings.backend,
            sampling: settings.sampling,
            full_resolution_mirrors: settings.full_resolution_mirrors && settings.technique.trace_scale() > 1,
            denoiser: ReflectionDenoiser {
                half_resolution: settings.denoiser.half_resolution && settings.technique.trace_scale() > 1,
                ..clamped_denoiser(&settings.denoiser)
            },
            fade_start: if cutoff < 1.0 { (cutoff - fade).max(0.0) } else { 1.0 },
            cutoff: between_steps(cutoff),
            max_ray_length: number_or(settings.max_ray_length, default.max_ray_length).clamp(0.0, 1.0e9),
            max_bounces: settings.max_bounces.clamp(1, MAX_BOUNCES),
            bounce_cutoff: number_or(settings.bounce_roughness_cutoff, default.bounce_roughness_cutoff).clamp(0.0, 1.0),
            screen_traces: settings.screen_traces,
            shadow_rays: settings.shadow_rays,
            fixed_mip: match settings.texture_mip {
                ReflectionTextureMip::RayCone => None,
                ReflectionTextureMip::Fixed(level) => Some(number_or(level, PAPER_LEVEL).clamp(0.0, 16.0)),
            },
            transparent: settings.transparent,
            forward: settings.forward,
            separate_denoiser: false,
        }
    }
}

fn clamped_denoiser(denoiser: &ReflectionDenoiser) -> ReflectionDenoiser {
    let default = ReflectionDenoiser::default();
    ReflectionDenoiser {
        samples: denoiser.samples.clamp(1, 16),
        max_history: number_or(denoiser.max_history, default.max_history).clamp(1.0, 255.0),
        clip_sigma: number_or(denoiser.clip_sigma, default.clip_sigma).clamp(0.5, 10.0),
        blur_radius: number_or(denoiser.blur_radius, default.blur_radius).clamp(0.0, 8.0),
        ..*denoiser
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_clamped() {
        let wild = RayTracedReflections {
            roughness_cutoff: f32::NAN,
            roughness_fade: f32::INFINITY,
            max_ray_length: f32::NEG_INFINITY,
            max_bounces: 0,
            bounce_roughness_cutoff: f32::NAN,
            texture_mip: ReflectionTextureMip::Fixed(-7.0),
            ..Default::default()
        };
        let safe = ClampedSettings::from(&wild);
        assert_eq!(safe.cutoff, 255.5 / 255.0);
        assert_eq!(safe.max_ray_length, 0.0);
        assert_eq!((safe.max_bounces, safe.bounce_cutoff), (1, 0.3));
        assert!(!safe.has_bounces());
        assert_eq!(safe.fixed_mip, Some(0.0));
        let many = ClampedSettings::from(&RayTracedReflections {
            max_bounces: u32::MAX,
            bounce_roughness_cutoff: f32::INFINITY,
            ..Default::default()
        });
        assert_eq!((many.max_bounces, many.bounce_cutoff), (8, 1.0));
        assert!(many.has_bounces());
    }

    #[test]
    fn only_rays_of_lists_reuse_the_screen() {
        let reuses = |technique, backend| {
            ClampedSettings::from(&RayTracedReflections {
                technique,
                backend,
                screen_traces: ScreenTraces::Reuse,
                ..Default::default()
            })
            .reuses_screen()
        };
        for technique in ReflectionTechnique::ALL {
            let expected = !matches!(
                technique,
                ReflectionTechnique::QuarterInline | ReflectionTechnique::Converged
            );
            assert_eq!(reuses(technique, ReflectionBackend::Compute), expected, "{technique}");
            assert!(!reuses(technique, ReflectionBackend::HardwareVrs), "{technique}");
        }
        assert!(!ClampedSettings::from(&RayTracedReflections::default()).reuses_screen());
        let marches = |screen_traces, technique| {
            let settings = ClampedSettings::from(&RayTracedReflections {
                technique,
                screen_traces,
                ..Default::default()
            });
            (settings.reuses_screen(), settings.marches_screen())
        };
        let technique = ReflectionTechnique::Variable;
        assert_eq!(marches(ScreenTraces::Reuse, technique), (true, false));
        assert_eq!(marches(ScreenTraces::March, technique), (true, true));
        assert_eq!(
            marches(ScreenTraces::March, ReflectionTechnique::Converged),
            (false, false)
        );
    }

    #[test]
    fn reflections_fade_below_the_cutoff_unless_everything_reflects() {
        let band = |roughness_cutoff, roughness_fade| {
            let settings = RayTracedReflections {
                roughness_cutoff,
                roughness_fade,
                ..Default::default()
            };
            let ClampedSettings { fade_start, cutoff, .. } = ClampedSettings::from(&settings);
            (fade_start, cutoff)
        };
        assert_eq!(band(0.6, 0.1), (0.5, 153.5 / 255.0));
        assert_eq!(band(0.6, f32::INFINITY).0, 0.0);
        assert_eq!(band(1.0, 0.1), (1.0, 255.5 / 255.0));
    }
}
