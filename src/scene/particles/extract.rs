//! Copies particles from the main world, when some have changed.

use crate::{
    scene::{activity::SceneActivity, render_layers::SceneLayers},
    settings::{ReflectedParticle, ReflectedParticles},
};
use bevy::{
    asset::UntypedAssetId,
    camera::visibility::{InheritedVisibility, RenderLayers},
    color::{ColorToComponents, LinearRgba},
    ecs::{prelude::*, system::SystemParam},
    log::warn_once,
    math::Vec4,
    transform::components::GlobalTransform,
};

/// Coordinates are bounded, so that sums of their squares are finite.
const FARTHEST: f32 = 1e18;

/// Particles of one entity, in world space.
pub struct ParticleSet {
    pub material: UntypedAssetId,
    /// Groups of render layers that show them, as bits of instances' flags.
    pub groups: u32,
    /// Valid particles with an area.
    pub particles: Vec<ReflectedParticle>,
}

/// The particles of the main world.
#[derive(Resource, Default)]
pub struct ExtractedParticles {
    pub sets: Vec<ParticleSet>,
    /// Changes with each change of the particles.
    pub version: u64,
    /// Number of entities with particles, and of those with render layers: removed components have no change.
    counts: [usize; 2],
}

type Particles<'w, 's> = Query<
    'w,
    's,
    (
        Ref<'static, ReflectedParticles>,
        Ref<'static, GlobalTransform>,
        Ref<'static, InheritedVisibility>,
        Option<Ref<'static, RenderLayers>>,
    ),
>;

/// The parts of the main world that extraction reads.
#[derive(SystemParam)]
pub struct ParticleWorld<'w, 's> {
    all: Particles<'w, 's>,
}

/// Extracts all particles if any of them changed.
pub fn extract_particles(
    world: &ParticleWorld,
    activity: &SceneActivity,
    layers: &SceneLayers,
    extracted: &mut ExtractedParticles,
) {
    if !activity.active {
        if !extracted.sets.is_empty() {
            extracted.sets.clear();
            extracted.counts = [0; 2];
            extracted.version += 1;
        }
        return;
    }
    let mut counts = [0; 2];
    let mut is_changed = activity.started || layers.changed;
    for (particles, place, visibility, own_layers) in &world.all {
        counts[0] += 1;
        counts[1] += usize::from(own_layers.is_some());
        is_changed |= particles.is_changed() || place.is_changed() || visibility.is_changed();
        is_changed |= own_layers.is_some_and(|layers| layers.is_changed());
    }
    if counts == extracted.counts && (!is_changed || counts[0] == 0) {
        return;
    }
    extracted.counts = counts;
    extracted.version += 1;
    extracted.sets.clear();
    let sets = world.all.iter().map(|(particles, place, visibility, own_layers)| {
        let groups = layers.groups_of(own_layers.as_deref());
        let is_shown = visibility.get() && groups != 0;
        let shown = if is_shown { particles.particles.as_slice() } else { &[] };
        ParticleSet {
            material: particles.material.id().untyped(),
            groups,
            particles: shown.iter().filter_map(|particle| placed(particle, &place)).collect(),
        }
    });
    extracted.sets.extend(sets);
}

/// A particle in world space, if it has an area. Invalid ones are left out.
fn placed(particle: &ReflectedParticle, place: &GlobalTransform) -> Option<ReflectedParticle> {
    let position = place.transform_point(particle.position);
    let color = particle.color.to_vec4();
    let is_valid = position.is_finite()
        && position.abs().max_element() < FARTHEST
        && particle.size.is_finite()
        && particle.size.max_element() < FARTHEST
        && particle.size.min_element() >= 0.0
        && particle.rotation.is_finite()
        && color.is_finite();
    if !is_valid {
        warn_once!("reflections leave out particles with values that aren't finite or with a negative size");
        return None;
    }
    let color = color.max(Vec4::ZERO);
    (particle.size.min_element() > 0.0).then_some(ReflectedParticle {
        position,
        color: LinearRgba::from_f32_array(color.to_array()),
        ..*particle
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::math::{Vec2, Vec3};

    #[test]
    fn particles_follow_their_entity_and_invalid_ones_are_left_out() {
        let place = GlobalTransform::from_xyz(1.0, 2.0, 3.0);
        let good = ReflectedParticle {
            position: Vec3::X,
            ..ReflectedParticle::default()
        };
        let found = placed(&good, &place).unwrap();
        assert_eq!((found.position, found.size), (Vec3::new(2.0, 2.0, 3.0), Vec2::ONE));
        let mut bad = [good; 5];
        bad[0].position.y = f32::NAN;
        bad[1].size.x = -0.1;
        bad[2].size.y = f32::INFINITY;
        bad[3].rotation = f32::NAN;
        bad[4].color.red = f32::INFINITY;
        for particle in bad {
            assert_eq!(placed(&particle, &place), None, "{particle:?}");
        }
        let flat = ReflectedParticle {
            size: Vec2::new(1.0, 0.0),
            ..good
        };
        assert_eq!(placed(&flat, &place), None);
    }
}
