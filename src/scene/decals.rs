//! Bevy's clustered decals: a table in the geometry buffer, which `decals.wesl` reads. All decals of the scene are used, since rays hit
//! surfaces outside the camera's view.
//!
//! `extract.rs` copies them from the main world.

mod extract;

pub(super) use extract::{DecalWorld, ExtractedDecals, extract_decals};

use super::{
    bevy_shaders::lighting_defines,
    box_tree::{BoxTable, TablePlace},
    change::Change,
    gpu_types::NO_TEXTURE,
    meshes::SceneMeshes,
    textures::TextureTable,
};
use bevy::{
    asset::AssetId, image::Image, log::warn_once, pbr::deferred::DeferredLightingLayout,
    platform::collections::HashSet, render::renderer::RenderQueue,
};
use bytemuck::{Pod, Zeroable};
use extract::DecalSource;

/// Maximum number of decals, of 64 bytes each and 24 for a node. A higher value costs memory. The loop of
/// `decals.wesl` visits only decals near the hit.
const MAX_DECALS: usize = 1 << 14;
/// Frames in which no material shows decals until that is logged. With a larger value, the message comes later, and less often while a
/// level is still loading.
const PATIENCE: u32 = 300;
/// Shader definition with which Bevy draws decals.
const DEFINITION: &str = "CLUSTERED_DECALS_ARE_USABLE";

/// A decal in the shaders' layout: [`DECAL_WORDS`] words.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct GpuDecal {
    /// Rows of the 3x4 matrix into a space in which its box extends from -0.5 to 0.5.
    decal_from_world: [[f32; 4]; 3],
    /// Base colour, normal map, metallic and roughness, emission. Words of the table of textures, or `NO_TEXTURE`.
    textures: [u32; 4],
}

/// Words of a decal; `decals.wesl` has the same number.
const DECAL_WORDS: usize = 16;
const _: () = assert!(size_of::<GpuDecal>() == 4 * DECAL_WORDS);

/// The decals on the GPU.
#[derive(Default)]
pub(super) struct DecalTable {
    /// Whether Bevy draws decals; `None` until that is known.
    drawn: Option<bool>,
    /// In the order of the main world.
    given: Vec<GpuDecal>,
    /// The images of each of them.
    painted: Vec<[Option<AssetId<Image>>; 4]>,
    table: BoxTable,
    /// Version of the extracted decals in the table, and whether some material showed them.
    version: Option<(u64, bool)>,
    /// Number of decals in the scene.
    count: usize,
    /// Used places in the table of textures when an image found none.
    full_at: Option<u64>,
    /// Images that the decals use.
    images: HashSet<AssetId<Image>>,
    /// Number of frames in which no material showed them.
    unseen: u32,
}

impl DecalTable {
    /// Returns whether shaders need the feature. `on_materials` if some material shows decals.
    pub fn are_shown(&mut self, on_materials: bool) -> bool {
        let exist = self.count > 0 && self.drawn == Some(true);
        self.unseen = if exist && !on_materials {
            self.unseen.saturating_add(1)
        } else {
            0
        };
        // Materials can be loaded later than decals.
        if self.unseen > PATIENCE {
            warn_once!(
                "no reflected material shows the clustered decals, since Bevy draws them only in its forward pass: set `OpaqueRendererMethod::Forward` \
                 on materials that should show decals, and `RayTracedReflections::forward` on cameras where these should reflect"
            );
        }
        exist && on_materials
    }

    /// Where shaders find them.
    pub fn place(&self) -> TablePlace {
        self.table.place()
    }

    /// Removes all decals. Their images go with the table of textures.
    pub fn clear(&mut self, meshes: &mut SceneMeshes) {
        self.table.clear(meshes);
        *self = Self {
            drawn: self.drawn,
            ..Self::default()
        };
    }

    /// Updates the table to the extracted decals. `resettled` are images that were loaded or have new content. Returns the change for rays.
    pub fn follow(
        &mut self,
        (extracted, on_materials): (&ExtractedDecals, bool),
        lighting: Option<&DeferredLightingLayout>,
        resettled: &HashSet<AssetId<Image>>,
        textures: &mut TextureTable,
        meshes: &mut SceneMeshes,
        queue: &RenderQueue,
    ) -> Change {
        self.count = extracted.decals.len();
        if extracted.decals.is_empty() && self.given.is_empty() {
            return Change::Nothing;
        }
        self.drawn = self.drawn.or_else(|| lighting_defines(lighting, DEFINITION));
        if self.drawn != Some(true) {
            return Change::Nothing;
        }
        let is_repainted = self.images.iter().any(|image| resettled.contains(image));
        let must_move = self.table.must_move(meshes);
        let has_room = self.full_at.is_some_and(|used| textures.used() < used);
        let version = Some((extracted.version, on_materials));
        if self.version == version && !is_repainted && !must_move && !has_room {
            return Change::Nothing;
        }
        self.version = version;
        // What no material shows must keep no view from coming to rest.
        let decals = if on_materials { &extracted.decals[..] } else { &[] };
        let shown = &decals[..decals.len().min(MAX_DECALS)];
        if shown.len() < decals.len() {
            warn_once!("reflections show {MAX_DECALS} of {} decals", decals.len());
        }
        let keeps_images = !is_repainted
            && self.full_at.is_none()
            && shown.iter().map(|decal| decal.images).eq(self.painted.iter().copied());
        if !keeps_images {
            self.use_images(shown, textures);
            self.painted = shown.iter().map(|decal| decal.images).collect();
        }
        let word = |image: Option<AssetId<Image>>| image.and_then(|image| textures.packed(image)).unwrap_or(NO_TEXTURE);
        let packed: Vec<GpuDecal> = shown
            .iter()
            .enumerate()
            .map(|(index, decal)| GpuDecal {
                decal_from_world: decal.decal_from_world,
                textures: match self.given.get(index) {
                    Some(given) if keeps_images => given.textures,
                    _ => decal.images.map(word),
                },
            })
            .collect();
        if packed == self.given && !is_repainted && !must_move {
            return Change::Nothing;
        }
        let last = self.place();
        let boxes = shown.iter().map(|decal| decal.bounds);
        if !self.table.write(&packed, boxes, meshes, queue) {
            warn_once!("reflections show no decals, since the device lacks memory for them");
        }
        self.given = packed;
        let is_absent = last == TablePlace::default() && self.place() == last;
        if is_absent { Change::Nothing } else { Change::Unmarked }
    }

    /// Adds new images to the table of textures, and gives back those that no decal uses any more.
    fn use_images(&mut self, decals: &[DecalSource], textures: &mut TextureTable) {
        let wanted: HashSet<_> = decals.iter().flat_map(|decal| decal.images).flatten().collect();
        let before = core::mem::take(&mut self.images);
        // New images come first, so that unchanged ones keep their index.
        let count = wanted.len();
        self.images = wanted
            .into_iter()
            .filter(|image| before.contains(image) || textures.acquire(*image))
            .collect();
        self.full_at = (self.images.len() < count).then(|| textures.used());
        for image in before.difference(&self.images) {
            textures.release(*image);
        }
    }
}

#[cfg(test)]
mod tests;
