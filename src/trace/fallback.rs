//! Which back end turns a camera's rates into rays, and what is said where it isn't the one that was asked for.

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

/// The back end for settings: [`ReflectionBackend::Compute`] or [`ReflectionBackend::HardwareVrs`], and why it isn't the latter
/// though it was asked for. Only rates that vary have a choice.
pub(crate) fn choose(
    settings: &ClampedSettings,
    available: impl FnOnce() -> Result<(), String>,
) -> (ReflectionBackend, Option<String>) {
    if settings.technique != ReflectionTechnique::Variable || settings.backend != ReflectionBackend::HardwareVrs {
        return (ReflectionBackend::Compute, None);
    }
    if settings.has_bounces() {
        return (
            ReflectionBackend::Compute,
            Some("its rays end at their first hit, and `max_bounces` is more than 1".into()),
        );
    }
    match available() {
        Ok(()) => (ReflectionBackend::HardwareVrs, None),
        Err(reason) => (ReflectionBackend::Compute, Some(reason)),
    }
}

/// Cameras that asked for hardware and got compute.
#[derive(Default)]
pub(crate) struct Fallbacks {
    reasons: EntityHashMap<String>,
    /// Sentences in the status for these reasons.
    sentences: Vec<String>,
}

impl Fallbacks {
    /// Warns where the reason is another than in the last frame.
    pub(crate) fn note(&mut self, camera: &NameOrEntityItem, reason: Option<String>) {
        let Some(reason) = reason else {
            self.reasons.remove(&camera.entity);
            return;
        };
        if self.reasons.get(&camera.entity) != Some(&reason) {
            warn!(
                "camera {camera}: {}; it works on Vulkan devices with `VK_KHR_fragment_shading_rate`, with \
                 `HardwareVrsPlugin` before `DefaultPlugins`, tiles of a size that the device has (`ShadingRateTileSize`) and a single \
                 bounce, and with `ReflectionBackend::Auto` nothing is missed",
                sentence(&reason)
            );
            self.reasons.insert(camera.entity, reason);
        }
    }

    /// Brings the status up to date, with the cameras that are left.
    pub(crate) fn publish(&mut self, cameras: &EntityHashSet, status: &ReflectionStatus) {
        self.reasons.retain(|camera, _| cameras.contains(camera));
        let mut sentences: Vec<_> = self.reasons.values().map(|reason| sentence(reason)).collect();
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

fn sentence(reason: &str) -> String {
    format!("the hardware back end was asked for, but {reason}; compute is used instead")
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

    #[test]
    fn only_rates_that_vary_are_traced_by_hardware() {
        let hardware = settings(ReflectionTechnique::Variable, ReflectionBackend::HardwareVrs);
        assert_eq!(choose(&hardware, || Ok(())), (ReflectionBackend::HardwareVrs, None));
        let reason = || Err("it rains".to_owned());
        assert_eq!(
            choose(&hardware, reason),
            (ReflectionBackend::Compute, Some("it rains".into()))
        );
        let bounces = ClampedSettings {
            max_bounces: 2,
            ..hardware
        };
        let (backend, reason_for_bounces) = choose(&bounces, || Ok(()));
        assert_eq!(backend, ReflectionBackend::Compute);
        assert!(reason_for_bounces.is_some_and(|reason| reason.contains("`max_bounces`")));
        for others in [
            settings(ReflectionTechnique::Quarter, ReflectionBackend::HardwareVrs),
            settings(ReflectionTechnique::Variable, ReflectionBackend::Auto),
            settings(ReflectionTechnique::Variable, ReflectionBackend::Compute),
        ] {
            assert_eq!(choose(&others, || Ok(())), (ReflectionBackend::Compute, None));
            assert_eq!(choose(&others, reason), (ReflectionBackend::Compute, None));
        }
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
        // The last one is gone.
        fallbacks.publish(&EntityHashSet::default(), &status);
        assert_eq!(reasons(), ["the BVH was asked for"]);
    }
}
