//! Chooses the pass that turns a camera's rates into rays, and reports deviations from the requested one.

use crate::{
    settings::{ClampedSettings, ReflectionBackend, ReflectionTechnique},
    status::ReflectionStatus,
};
use bevy::{
    ecs::{
        entity::{EntityHashMap, EntityHashSet},
        name::NameOrEntityItem,
    },
    log::warn,
};

/// Replaces a requested pass by one that the device supports: it resolves the back end to [`ReflectionBackend::Compute`] or
/// [`ReflectionBackend::HardwareVrs`], and replaces the fragment-shader technique by compute shaders if fragment shaders can't trace
/// rays. Returns the reason for a replacement. Only variable rates have a choice of back ends.
pub(crate) fn choose(
    settings: &mut ClampedSettings,
    fragment_rays: Result<(), &'static str>,
    hardware: impl FnOnce() -> Result<(), String>,
) -> Option<String> {
    let wanted = settings.backend;
    settings.backend = ReflectionBackend::Compute;
    match (settings.technique, wanted) {
        (ReflectionTechnique::QuarterInline, _) => {
            let reason = fragment_rays.err()?;
            settings.technique = ReflectionTechnique::Quarter;
            Some(format!(
                "rays from fragment shaders were asked for, but {reason}; a compute shader traces the same rays instead"
            ))
        }
        (ReflectionTechnique::Variable, ReflectionBackend::HardwareVrs) => {
            let one_bounce = if settings.has_bounces() {
                Err("its rays end at their first hit, and `max_bounces` is more than 1".to_owned())
            } else {
                Ok(())
            };
            let fragment_rays = fragment_rays.map_err(str::to_owned);
            let Err(reason) = one_bounce.and(fragment_rays).and_then(|()| hardware()) else {
                settings.backend = ReflectionBackend::HardwareVrs;
                return None;
            };
            Some(format!(
                "the hardware back end was asked for, but {reason}; compute is used instead"
            ))
        }
        _ => None,
    }
}

/// Cameras with another pass than they requested.
#[derive(Default)]
pub(crate) struct Fallbacks {
    reasons: EntityHashMap<String>,
    /// The reasons as sentences for the status.
    sentences: Vec<String>,
}

impl Fallbacks {
    /// Warns if the reason has changed since the last frame.
    pub(crate) fn note(&mut self, camera: &NameOrEntityItem, reason: Option<String>) {
        let Some(reason) = reason else {
            self.reasons.remove(&camera.entity);
            return;
        };
        if self.reasons.get(&camera.entity) != Some(&reason) {
            warn!("camera {camera}: {reason}");
            self.reasons.insert(camera.entity, reason);
        }
    }

    /// Updates the status, for the remaining cameras.
    pub(crate) fn publish(&mut self, cameras: &EntityHashSet, status: &ReflectionStatus) {
        self.reasons.retain(|camera, _| cameras.contains(camera));
        let mut sentences: Vec<_> = self.reasons.values().cloned().collect();
        sentences.sort_unstable();
        sentences.dedup();
        if sentences == self.sentences {
            return;
        }
        status.update(|report| {
            report.reasons.retain(|known| !self.sentences.contains(known));
            report.reasons.extend(sentences.iter().cloned());
        });
        self.sentences = sentences;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::RayTracedReflections;
    use bevy::ecs::entity::Entity;

    fn settings(technique: ReflectionTechnique, backend: ReflectionBackend) -> ClampedSettings {
        ClampedSettings::from(&RayTracedReflections {
            technique,
            backend,
            ..Default::default()
        })
    }

    /// Resulting technique and back end of these settings, and the message.
    fn chosen(
        mut settings: ClampedSettings,
        fragment_rays: Result<(), &'static str>,
        hardware: Result<(), String>,
    ) -> (ReflectionTechnique, ReflectionBackend, Option<String>) {
        let said = choose(&mut settings, fragment_rays, || hardware);
        (settings.technique, settings.backend, said)
    }

    #[test]
    fn only_rates_that_vary_are_traced_by_hardware() {
        use ReflectionBackend::{Auto, Compute, HardwareVrs};
        use ReflectionTechnique::{Quarter, Variable};
        let hardware = settings(Variable, HardwareVrs);
        assert_eq!(chosen(hardware, Ok(()), Ok(())), (Variable, HardwareVrs, None));
        for (fragments, rates) in [(Ok(()), Err("it rains".into())), (Err("it rains"), Ok(()))] {
            let (technique, backend, said) = chosen(hardware, fragments, rates);
            assert_eq!((technique, backend), (Variable, Compute));
            assert!(said.is_some_and(|said| said.contains("hardware back end") && said.contains("it rains")));
            let bounces = ClampedSettings {
                max_bounces: 2,
                ..hardware
            };
            let (_, backend, said) = chosen(bounces, Ok(()), Ok(()));
            assert_eq!(backend, Compute);
            assert!(said.is_some_and(|said| said.contains("`max_bounces`")));
        }
        for (technique, backend) in [(Quarter, HardwareVrs), (Variable, Auto), (Variable, Compute)] {
            for hardware in [Ok(()), Err("it rains".to_owned())] {
                let others = settings(technique, backend);
                assert_eq!(chosen(others, Ok(()), hardware), (technique, Compute, None));
            }
        }
    }

    #[test]
    fn compute_traces_what_fragments_can_not() {
        use ReflectionTechnique::{Quarter, QuarterInline};
        let inline = settings(QuarterInline, ReflectionBackend::Auto);
        assert_eq!(
            chosen(inline, Ok(()), Ok(())),
            (QuarterInline, ReflectionBackend::Compute, None)
        );
        let (technique, backend, said) = chosen(inline, Err("it rains"), Ok(()));
        assert_eq!((technique, backend), (Quarter, ReflectionBackend::Compute));
        assert!(said.is_some_and(|said| said.contains("fragment shaders") && said.contains("it rains")));
    }

    #[test]
    fn the_status_says_why_while_it_is_so() {
        let status = ReflectionStatus::default();
        status.update(|report| report.reasons = vec!["the BVH was asked for".into()]);
        let reasons = || status.report().reasons;
        let cameras: Vec<_> = (1..4).filter_map(Entity::from_raw_u32).collect();
        let present = cameras.iter().copied().collect();
        let mut fallbacks = Fallbacks::default();
        let nameless = |entity| NameOrEntityItem { name: None, entity };
        for camera in &cameras {
            fallbacks.note(&nameless(*camera), Some("it rains".into()));
        }
        fallbacks.publish(&present, &status);
        assert_eq!(reasons().len(), 2);
        assert!(reasons()[1].contains("it rains"));
        fallbacks.note(&nameless(cameras[0]), Some("it snows".into()));
        fallbacks.publish(&present, &status);
        assert_eq!(reasons().len(), 3);
        for camera in &cameras[..2] {
            fallbacks.note(&nameless(*camera), None);
        }
        fallbacks.publish(&present, &status);
        assert_eq!(reasons().len(), 2);
        // The last camera is gone.
        fallbacks.publish(&EntityHashSet::default(), &status);
        assert_eq!(reasons(), ["the BVH was asked for"]);
    }
}
