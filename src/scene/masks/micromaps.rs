//! Decides when the masks of a mesh and a material have opacity micromaps.
//!
//! They are built off the main thread once the material has settled, and are dropped in the frame in which it changes: until new
//! ones are ready, each candidate samples its texture.

use crate::{
    device::ReflectionTextureMode,
    scene::{
        alpha_images::{AlphaImages, ImageContent, ImageState},
        bvh::{AlphaTest, Item, Micromap, OpacityBaker, Wrap, masks, micromap_of},
        gpu_types::COVERAGE,
        materials::{MaterialAssets, pack_material},
        meshes::MeshTriangles,
        textures::TextureTable,
        tree_builds,
    },
};
use bevy::{
    asset::{AssetId, UntypedAssetId},
    image::{Image, ImageSamplerDescriptor},
    math::{Affine2, Mat2, Vec2},
    mesh::Mesh,
};
use std::sync::Arc;

/// Frames without a change until a material counts as settled: fewer than until objects are merged.
const QUIET_FRAMES: u64 = 15;

/// Identifies the masks of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::scene) struct MaskKey {
    pub mesh: AssetId<Mesh>,
    /// Version of the mesh.
    pub version: u64,
    pub material: UntypedAssetId,
    /// The material uses the second set of UV coordinates.
    pub second_uvs: bool,
}

/// Micromaps of all triangles of a mesh with a unique name, which is 0 if they are unknown.
#[derive(Clone, Default)]
pub(in crate::scene) struct NamedMicromaps {
    pub name: u64,
    pub maps: Option<Arc<[Micromap]>>,
}

/// Sources of the materials of masks.
pub(in crate::scene) struct Surroundings<'a> {
    pub materials: &'a MaterialAssets,
    pub textures: &'a TextureTable,
    pub default_sampler: &'a ImageSamplerDescriptor,
}

/// The parameters of a material that affect its masks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Look {
    uv_transform: Affine2,
    /// `None` if micromaps can't be built.
    test: Option<Test>,
}

/// Further inputs of the alpha test.
#[derive(Clone, Debug, PartialEq)]
struct Test {
    alpha: f32,
    cutoff: f32,
    texture: Option<(ImageContent, [Wrap; 2])>,
}

enum BakeState {
    /// Since this frame.
    Waiting(u64),
    Baking(tree_builds::Build<Vec<Item>>),
    /// Nothing left to do.
    Done,
}

/// The micromaps of a set of masks.
pub(super) struct Micromaps {
    look: Look,
    state: BakeState,
    /// Micromaps that are stored in the buffer.
    named: NamedMicromaps,
}

impl Look {
    pub fn of(key: &MaskKey, surroundings: &Surroundings) -> Self {
        let Some(material) = surroundings.materials.get(key.material) else {
            return Self {
                uv_transform: Affine2::IDENTITY,
                test: None,
            };
        };
        let packed = pack_material(material);
        let image = material.base_color_texture.as_ref().map(|image| image.id());
        let texture = match image {
            None => Some(None),
            Some(image) => surroundings
                .textures
                .finest_level(image, surroundings.default_sampler)
                .map(|(version, wrap)| Some(((image, version), wrap))),
        };
        // Texture layers contain smaller copies of the images, which aren't available here.
        let is_known = matches!(surroundings.textures.mode(), ReflectionTextureMode::Bindless { .. });
        // The test's result isn't known in advance if it also depends on a random number per ray, or on another cutoff for shadow rays.
        let is_known = is_known && packed.stop_probability < 0.0 && packed.stop_probability != COVERAGE;
        Self {
            uv_transform: Affine2::from_mat2_translation(
                Mat2::from_cols_array(&packed.uv_transform),
                Vec2::from(packed.uv_offset),
            ),
            test: texture.filter(|_| is_known).map(|texture| Test {
                alpha: packed.base_color[3],
                cutoff: packed.alpha_cutoff,
                texture,
            }),
        }
    }

    fn first_state(&self, frame: u64) -> BakeState {
        match self.test {
            Some(_) => BakeState::Waiting(frame),
            None => BakeState::Done,
        }
    }
}

impl Micromaps {
    pub fn new(look: Look, frame: u64) -> Self {
        Self {
            state: look.first_state(frame),
            look,
            named: NamedMicromaps::default(),
        }
    }

    /// Updates the material's parameters. Returns whether the micromaps in the buffer are now invalid.
    pub fn update_look(&mut self, look: Look, frame: u64) -> bool {
        if look == self.look {
            return false;
        }
        let is_wrong = self.named.name != 0;
        *self = Self::new(look, frame);
        is_wrong
    }

    /// Advances the work, but starts no new work unless `may_start` is set. `sampled` returns whether shaders sample this image
    /// for these masks. Returns the masks once they have micromaps.
    pub fn carry_on(
        &mut self,
        key: &MaskKey,
        triangles: &Arc<MeshTriangles>,
        sampled: impl Fn(AssetId<Image>) -> bool,
        may_start: bool,
        images: &mut AlphaImages,
        frame: u64,
        next_name: &mut u64,
    ) -> Option<Vec<Item>> {
        match &mut self.state {
            BakeState::Waiting(since) if may_start && frame >= *since + QUIET_FRAMES => {
                let test = self.look.test.clone()?;
                // The material's texture might not have fit into the table.
                if test.texture.is_some_and(|((image, _), _)| !sampled(image)) {
                    self.state = BakeState::Done;
                    return None;
                }
                let texture = match test.texture {
                    None => None,
                    Some((content, wrap)) => match images.get(content) {
                        ImageState::Ready(texels) => Some((texels, wrap)),
                        ImageState::Loading => return None,
                        ImageState::Unreadable => {
                            self.state = BakeState::Done;
                            return None;
                        }
                    },
                };
                let test = AlphaTest {
                    alpha: test.alpha,
                    cutoff: test.cutoff,
                    texture,
                };
                let (triangles, second_uvs, transform) = (triangles.clone(), key.second_uvs, self.look.uv_transform);
                self.state = BakeState::Baking(tree_builds::spawn(async move {
                    let baker = OpacityBaker::new(&test);
                    masks(&triangles.mask_source(second_uvs, transform), Some(&baker))
                }));
                None
            }
            BakeState::Baking(task) if task.is_finished() => {
                let items = task.take();
                self.state = BakeState::Done;
                *next_name += 1;
                let mergeable = items.as_ref().filter(|_| !triangles.positions().is_empty());
                self.named = NamedMicromaps {
                    name: *next_name,
                    maps: mergeable.map(|items| items.iter().map(micromap_of).collect()),
                };
                items
            }
            _ => None,
        }
    }

    /// UV transform of the masks.
    pub fn uv_transform(&self) -> Affine2 {
        self.look.uv_transform
    }

    /// The name of the micromaps in the buffer, or 0.
    pub fn name(&self) -> u64 {
        self.named.name
    }

    /// Returns the micromaps that are stored in the buffer.
    pub fn named(&self) -> NamedMicromaps {
        self.named.clone()
    }

    /// Returns whether there is work left.
    pub fn is_unfinished(&self) -> bool {
        !matches!(self.state, BakeState::Done)
    }

    /// Returns whether they are being built, or due to be.
    pub fn is_due(&self, frame: u64) -> bool {
        match self.state {
            BakeState::Waiting(since) => frame >= since + QUIET_FRAMES,
            BakeState::Baking(_) => true,
            BakeState::Done => false,
        }
    }

    /// Returns whether a task is building them.
    pub fn is_baking(&self) -> bool {
        matches!(self.state, BakeState::Baking(_))
    }

    /// Returns whether they will be built if nothing changes, and nothing changed in the last frame.
    pub fn is_pending(&self, frame: u64) -> bool {
        match self.state {
            BakeState::Waiting(since) => frame > since + 1,
            BakeState::Baking(_) => true,
            BakeState::Done => false,
        }
    }

    /// Returns whether the alpha channel of this image is still needed.
    pub fn waits_for(&self, content: &ImageContent) -> bool {
        let wanted = self.look.test.as_ref().and_then(|test| test.texture);
        matches!(self.state, BakeState::Waiting(_)) && wanted.is_some_and(|(wanted, _)| wanted == *content)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(cutoff: f32, u: f32) -> Look {
        Look {
            uv_transform: Affine2::from_translation(Vec2::new(u, 0.0)),
            test: Some(Test {
                alpha: 1.0,
                cutoff,
                texture: None,
            }),
        }
    }

    #[test]
    fn changes_take_micromaps_back() {
        let mut maps = Micromaps::new(look(0.5, 0.0), 0);
        assert!(maps.is_unfinished());
        assert!(!maps.update_look(look(0.5, 0.0), 1), "nothing changed");
        assert!(!maps.update_look(look(0.6, 0.0), 2), "there were no micromaps");
        assert!(!maps.update_look(look(0.6, 0.5), 3), "nor now");
        maps.named = NamedMicromaps {
            name: 7,
            maps: Some(Arc::default()),
        };
        maps.state = BakeState::Done;
        assert!(!maps.update_look(look(0.6, 0.5), 4));
        assert_eq!(maps.name(), 7);
        assert!(maps.update_look(look(0.7, 0.5), 5));
        assert_eq!(maps.name(), 0);
        assert!(matches!(maps.state, BakeState::Waiting(5)));
    }
}
