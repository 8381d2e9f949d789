//! Particles of `ReflectedParticles`: a table in the geometry buffer, which `particles.wesl` reads.
//!
//! `extract.rs` copies them from the main world.

mod extract;

pub(super) use extract::{ExtractedParticles, ParticleWorld, extract_particles};

use super::{
    box_tree::{Box6, BoxTable, TablePlace},
    change::Change,
    materials::{MaterialAssets, MaterialTable},
    meshes::SceneMeshes,
};
use bevy::{
    color::ColorToComponents, log::warn_once, math::Vec3, pbr::StandardMaterial, prelude::AlphaMode,
    render::renderer::RenderQueue,
};
use bytemuck::{Pod, Zeroable};

/// Maximum number of particles; it bounds a loop of `particles.wesl`.
const MAX_PARTICLES: usize = 1 << 18;

/// A particle in the shaders' layout: [`PARTICLE_WORDS`] words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuParticle {
    /// Centre in world space.
    position: [f32; 3],
    /// Half width and half height in metres, above 0.
    half_size: [f32; 2],
    /// Radians.
    rotation: f32,
    /// Index in the material buffer.
    material: u32,
    /// One of the `MODE_` constants, and the groups of render layers.
    flags: u32,
    /// Linear.
    color: [f32; 4],
}

/// Words of a particle; `particles.wesl` has the same number.
const PARTICLE_WORDS: usize = 12;
const _: () = assert!(size_of::<GpuParticle>() == 4 * PARTICLE_WORDS);

/// Alpha modes; `trace/particles.wesl` has the same numbers.
const MODE_OPAQUE: u32 = 0;
const MODE_MASK: u32 = 1;
const MODE_BLEND: u32 = 2;
const MODE_PREMULTIPLIED: u32 = 3;
const MODE_ADD: u32 = 4;
const MODE_MULTIPLY: u32 = 5;

fn mode_of(material: &StandardMaterial) -> u32 {
    match material.alpha_mode {
        AlphaMode::Opaque => MODE_OPAQUE,
        AlphaMode::Mask(_) | AlphaMode::AlphaToCoverage => MODE_MASK,
        AlphaMode::Blend => MODE_BLEND,
        AlphaMode::Premultiplied => MODE_PREMULTIPLIED,
        AlphaMode::Add => MODE_ADD,
        AlphaMode::Multiply => MODE_MULTIPLY,
    }
}

/// The particles on the GPU.
#[derive(Default)]
pub(super) struct ParticleTable {
    /// In the order of the app.
    given: Vec<GpuParticle>,
    table: BoxTable,
    /// Version of the extracted particles in the table.
    version: u64,
    /// Some entity has particles, or could have them in any frame.
    exists: bool,
    /// Some of them are lit.
    is_lit: bool,
    /// They changed in this frame.
    move_now: bool,
}

impl ParticleTable {
    /// Returns whether shaders need the feature.
    pub fn exists(&self) -> bool {
        self.exists
    }

    /// Returns whether some particles are lit.
    pub fn is_lit(&self) -> bool {
        self.is_lit
    }

    /// Where shaders find them.
    pub fn place(&self) -> TablePlace {
        self.table.place()
    }

    /// Returns whether they changed in this frame.
    pub fn move_now(&self) -> bool {
        self.move_now && self.place() != TablePlace::default()
    }

    /// Removes all particles.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        self.table.clear(meshes);
        *self = Self::default();
    }

    /// Updates the table to the extracted particles, if they or their materials changed. Returns the change for rays.
    pub fn update(
        &mut self,
        extracted: &ExtractedParticles,
        assets: &MaterialAssets,
        materials: &mut MaterialTable,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Change {
        let uses = |material| extracted.sets.iter().any(|set| set.material == material);
        // Rays count the changed surfaces that they hit, and no particles.
        let is_repainted = !extracted.sets.is_empty()
            && (assets.changed().any(uses) || extracted.sets.iter().any(|set| materials.is_restless(set.material)));
        let must_move = self.table.must_move(meshes);
        self.move_now = extracted.version != self.version || is_repainted;
        if !self.move_now && !must_move {
            return Change::Nothing;
        }
        self.version = extracted.version;
        self.exists = !extracted.sets.is_empty();
        self.is_lit = false;
        let mut packed = Vec::new();
        for set in &extracted.sets {
            // A material that isn't loaded is a change once it is.
            let Some(material) = assets.get(set.material) else {
                continue;
            };
            self.is_lit |= !material.unlit && material.alpha_mode != AlphaMode::Multiply;
            let index = materials.index(set.material);
            let flags = mode_of(material) | set.groups;
            packed.extend(set.particles.iter().map(|particle| GpuParticle {
                position: particle.position.to_array(),
                half_size: (0.5 * particle.size).to_array(),
                rotation: particle.rotation,
                material: index,
                flags,
                color: particle.color.to_f32_array(),
            }));
        }
        if packed.len() > MAX_PARTICLES {
            warn_once!("reflections show {MAX_PARTICLES} of {} particles", packed.len());
            packed.truncate(MAX_PARTICLES);
        }
        // Apps write the same particles again, too.
        if packed == self.given && !is_repainted && !must_move {
            self.move_now = false;
            return Change::Nothing;
        }
        if !self.table.write(&packed, packed.iter().map(bounds), meshes, queue) {
            warn_once!("reflections show no particles, since the device lacks memory for them");
        }
        self.given = packed;
        Change::Unmarked
    }
}

/// The box around a particle in any direction, enlarged by the rounding of the shader's tests.
fn bounds(particle: &GpuParticle) -> Box6 {
    let centre = Vec3::from(particle.position);
    let [x, y] = particle.half_size;
    let reach = 1.0001 * x.hypot(y) + 1e-6 * centre.abs().max_element();
    Box6::new(centre - reach, centre + reach)
}

#[cfg(test)]
mod tests;
