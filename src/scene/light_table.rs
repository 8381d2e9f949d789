//! The buffer of lights: up to [`MAX_LIGHTS`] as a list that hits evaluate, or more with a tree that they sample. Textures of lights
//! follow at the end.

use super::{
    gpu_types::GpuLight,
    light_textures::LightTextures,
    light_tree::{LightTree, Written},
    lights::{MAX_LIGHTS, Touched},
    scatter::ScatterKernels,
    upload::StorageSlice,
};
use bevy::render::{
    render_resource::{Buffer, PipelineCache},
    renderer::{RenderDevice, RenderQueue},
};

/// Lights on the GPU.
pub(super) struct LightTable {
    slice: StorageSlice<GpuLight>,
    tree: Option<LightTree>,
    /// Number of lights in the buffer, without the nodes of their tree.
    count: usize,
    /// Index of the first light texture in the buffer, and their number.
    textures: (usize, usize),
}

impl LightTable {
    pub fn new(device: &RenderDevice) -> Self {
        Self {
            slice: StorageSlice::new(device, "glint_lights"),
            tree: None,
            count: 0,
            textures: (0, 0),
        }
    }

    /// For binding.
    pub fn buffer(&self) -> &Buffer {
        self.slice.buffer()
    }

    /// Changes when [`Self::buffer`] becomes another object.
    pub fn generation(&self) -> u64 {
        self.slice.generation()
    }

    /// Takes over the kernel that uploads large changes.
    pub fn follow_kernel(&mut self, kernels: &ScatterKernels, cache: &PipelineCache) {
        self.slice.follow_kernel(kernels, cache);
    }

    /// For `SceneCounts::light_count`.
    pub fn count(&self) -> u32 {
        self.count as u32
    }

    /// For `SceneCounts::directional_light_count`.
    pub fn directional_count(&self) -> u32 {
        self.tree.as_ref().map_or(0, |tree| tree.directional_count() as u32)
    }

    /// For `SceneCounts::light_leaf_count`.
    pub fn leaf_count(&self) -> u32 {
        self.tree.as_ref().map_or(0, |tree| tree.leaf_count() as u32)
    }

    /// Counts a frame. Returns whether [`Self::write`] is due even if no light changed: the device might have memory now that it lacked.
    pub fn may_ask_again(&mut self) -> bool {
        self.slice.may_ask_again()
    }

    /// For `SceneCounts::first_light_texture` and `SceneCounts::light_texture_count`.
    pub fn textures(&self) -> [u32; 2] {
        [self.textures.0 as u32, self.textures.1 as u32]
    }

    /// Writes lights like [`Self::write`], with references to their textures, which follow them. While lights have textures, everything
    /// is rewritten.
    pub fn write_with_textures(
        &mut self,
        lights: &[GpuLight],
        touched: &Touched,
        textures: &LightTextures,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        let had_textures = self.textures.1 > 0;
        self.textures = (0, 0);
        if textures.is_empty() {
            let touched = if had_textures { &Touched::All } else { touched };
            if had_textures {
                // The tree in the buffer is overwritten.
                self.tree = None;
            }
            self.write(lights, touched, device, queue);
            return;
        }
        let mut tree = (lights.len() > MAX_LIGHTS).then(|| self.tree.take().unwrap_or_default());
        if let Some(tree) = &mut tree {
            // The tree's own table has no texture numbers.
            update(tree, lights, touched);
        }
        let mut table = tree.as_ref().map_or(lights, |tree| tree.table()).to_vec();
        let first = table.len();
        textures.append_to(&mut table, |light| {
            tree.as_ref().map_or(light as usize, |tree| tree.place_of(light))
        });
        self.slice.write(&table, 0..table.len(), device, queue);
        let room = self.slice.count();
        self.count = lights.len().min(room);
        self.tree = tree.filter(|_| room >= first);
        self.textures = (first, if room == table.len() { textures.len() } else { 0 });
    }

    /// Updates the buffer to the lights of the scene. If the device lacks memory for all lights with their tree, hits evaluate the
    /// first ones. Lights that aren't `touched` are unchanged.
    fn write(&mut self, lights: &[GpuLight], touched: &Touched, device: &RenderDevice, queue: &RenderQueue) {
        if lights.len() <= MAX_LIGHTS {
            self.tree = None;
            self.slice.write(lights, 0..lights.len(), device, queue);
            self.count = self.slice.count();
            return;
        }
        let mut tree = self.tree.take().unwrap_or_default();
        match update(&mut tree, lights, touched) {
            Written::All => {
                let table = tree.table();
                self.slice.write(table, 0..table.len(), device, queue);
            }
            Written::Elements(places) => {
                let places = places.to_vec();
                self.slice.write_elements(tree.table(), &places, device, queue);
            }
        }
        self.count = lights.len().min(self.slice.count());
        self.tree = (self.slice.count() == tree.table().len()).then_some(tree);
    }
}

fn update<'a>(tree: &'a mut LightTree, lights: &[GpuLight], touched: &Touched) -> Written<'a> {
    match touched {
        Touched::All => tree.update(lights),
        Touched::Lights(touched) => tree.update_some(lights, touched.iter().copied()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_gpu;

    #[test]
    fn textures_stand_behind_lights_and_the_tree_of_many() {
        let Some((device, queue)) = test_gpu::device() else {
            return;
        };
        let light = GpuLight {
            kind: 1,
            ..GpuLight::default()
        };
        let lights = [light; MAX_LIGHTS + 1];
        let textures = LightTextures::with_records(2);
        let none = LightTextures::default();
        let mut table = LightTable::new(&device);
        for (count, textures, leaves, places, elements) in [
            (3, &none, 0, [0, 0], 3),
            (MAX_LIGHTS, &none, 0, [0, 0], MAX_LIGHTS),
            (MAX_LIGHTS + 1, &none, 512, [0, 0], 769),
            (9, &none, 0, [0, 0], 9),
            (3, &textures, 0, [3, 2], 5),
            (MAX_LIGHTS + 1, &textures, 512, [769, 2], 771),
            (MAX_LIGHTS + 1, &none, 512, [0, 0], 769),
            (3, &none, 0, [0, 0], 3),
        ] {
            for touched in [Touched::All, Touched::default()] {
                table.write_with_textures(&lights[..count], &touched, textures, &device, &queue);
                assert_eq!((table.count(), table.leaf_count()), (count as u32, leaves));
                assert_eq!(table.textures(), places, "{count} lights");
                assert_eq!(table.slice.count(), elements, "{count} lights");
            }
        }
    }
}
