//! Known static scenes, and averages of their frames, for the measurements of energy and of flicker.

use crate::{
    harness::Harness,
    image::{LinearImage, luminance},
};
use bevy::{camera::Exposure, core_pipeline::tonemapping::Tonemapping, prelude::*};
use bevy_glint::{RayTracedReflections, ReflectionDebugView, ReflectionTechnique, named_settings};
use glint_scenes::{Random, SceneName, environment};

/// Maximum number of frames to wait for assets, pipelines and meshes.
const PATIENCE: u32 = 5000;

/// Techniques to measure: the ones that share one denoiser, finest first, then presets. The preset `medium` is `vrs-combined`.
pub const TECHNIQUES: [&str; 11] = [
    "reference",
    "vrs-combined",
    "vrs-roughness",
    "vrs-grazing",
    "vrs-adaptive",
    "quarter",
    "quarter-inline",
    "paper",
    "low",
    "high",
    "ultra",
];

/// A static scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StaticScene {
    BuiltIn(SceneName),
    /// Boxes, balls, small lamps and glowing panels at random.
    Random(u64),
}

impl StaticScene {
    /// The name for reports.
    pub fn name(self) -> String {
        match self {
            Self::BuiltIn(name) => name.as_str().to_owned(),
            Self::Random(seed) => format!("random {seed}"),
        }
    }
}

/// A scene with a camera that shows only the reflection.
pub struct StaticSceneView {
    root: Entity,
    pub camera: Entity,
}

impl StaticSceneView {
    /// Spawns a scene for the duration of `body`.
    pub fn with<T>(
        harness: &mut Harness,
        scene: StaticScene,
        size: UVec2,
        body: impl FnOnce(&mut Harness, &Self) -> T,
    ) -> T {
        let view = Self::new(harness, scene, size);
        let result = body(harness, &view);
        harness.world().despawn(view.camera);
        harness.world().despawn(view.root);
        harness.step(2);
        harness.reset_clocks();
        result
    }

    /// Spawns a scene and pauses its clock.
    fn new(harness: &mut Harness, scene: StaticScene, size: UVec2) -> Self {
        harness.reset_clocks();
        harness.world().resource_mut::<Time<Virtual>>().pause();
        match scene {
            StaticScene::BuiltIn(name) => {
                let (root, camera) = harness.spawn_scene(name, 64, size);
                Self { root, camera }
            }
            StaticScene::Random(seed) => random(harness, seed, size),
        }
    }

    /// Switches to a technique without roughness cut-off and clears its history; false if it can't be compiled. Fails if there is no
    /// technique of that name.
    pub fn switch(&self, harness: &mut Harness, name: &str, view: ReflectionDebugView) -> Result<bool, String> {
        self.show(harness, name, view, true)
    }

    /// Like [`switch`](Self::switch), without history: frames then differ by all the noise of their rays, independently of each other.
    pub fn switch_to_single_frames(
        &self,
        harness: &mut Harness,
        name: &str,
        view: ReflectionDebugView,
    ) -> Result<bool, String> {
        self.show(harness, name, view, false)
    }

    fn show(
        &self,
        harness: &mut Harness,
        name: &str,
        view: ReflectionDebugView,
        has_history: bool,
    ) -> Result<bool, String> {
        let (mut settings, heuristic) = named_settings(name).map_err(|error| error.to_string())?;
        (settings.roughness_cutoff, settings.roughness_fade) = (1.0, 0.0);
        settings.denoiser.temporal &= has_history;
        let mut camera = harness.world().entity_mut(self.camera);
        camera.insert((settings, heuristic, view, Tonemapping::None));
        let is_idle = harness.wait_until_idle(PATIENCE);
        if let Some(mut reflections) = harness.world().get_mut::<RayTracedReflections>(self.camera) {
            reflections.reset = true;
        }
        Ok(is_idle)
    }

    /// Renders frames and passes each image to `look`. Fails if an image can't be read, or has pixels that are not finite.
    pub fn watch(&self, harness: &mut Harness, frames: u32, mut look: impl FnMut(&LinearImage)) -> Result<(), String> {
        for frame in 0..frames {
            harness.step(1);
            let image = harness.image(self.camera)?;
            let checked = image.check_finite();
            checked.map_err(|error| format!("frame {frame}: {error}"))?;
            look(&image);
        }
        Ok(())
    }

    /// Renders frames and averages their luminances.
    pub fn average(&self, harness: &mut Harness, frames: u32) -> Result<Average, String> {
        let mut average = Average::default();
        self.watch(harness, frames, |image| average.add(image))?;
        Ok(average)
    }
}

/// Luminances of an image, averaged over frames.
#[derive(Clone, Debug, Default)]
pub struct Average {
    pub size: UVec2,
    /// Mean of each frame.
    pub frame_means: Vec<f64>,
    /// Largest value of each pixel in any frame.
    pub brightest: Vec<f32>,
    sums: Vec<f64>,
    squares: Vec<f64>,
}

impl Average {
    /// Adds a frame. All must have one size.
    pub fn add(&mut self, image: &LinearImage) {
        self.size = image.size;
        let count = image.texels.len();
        self.sums.resize(count, 0.0);
        self.squares.resize(count, 0.0);
        self.brightest.resize(count, f32::NEG_INFINITY);
        let mut sum = 0.0;
        for (index, texel) in image.texels.iter().enumerate() {
            let value = luminance(texel);
            self.brightest[index] = self.brightest[index].max(value);
            let value = f64::from(value);
            self.sums[index] += value;
            self.squares[index] += value * value;
            sum += value;
        }
        self.frame_means.push(sum / count.max(1) as f64);
    }

    fn frames(&self) -> f64 {
        self.frame_means.len().max(1) as f64
    }

    /// Mean of each pixel.
    pub fn means(&self) -> impl Iterator<Item = f64> + '_ {
        let frames = self.frames();
        self.sums.iter().map(move |sum| sum / frames)
    }

    /// Mean of all pixels and frames.
    pub fn mean(&self) -> f64 {
        self.frame_means.iter().sum::<f64>() / self.frames()
    }

    /// Flags of the pixels that show a reflection: at least this fraction of the mean of all.
    pub fn lit(&self, fraction: f64) -> Vec<bool> {
        let least = (fraction * self.mean()).max(1e-6);
        self.means().map(|mean| mean >= least).collect()
    }

    /// Mean flicker of some pixels: standard deviation from frame to frame over mean. The mean of a dark pixel is replaced by the
    /// fraction `dark` of the mean of all, since its flicker is invisible.
    pub fn flicker(&self, pixels: &[bool], dark: f64) -> f64 {
        let frames = self.frames();
        let least = (dark * self.mean()).max(1e-6);
        let (mut sum, mut count) = (0.0, 0_u32);
        for (index, is_counted) in pixels.iter().enumerate().take(self.sums.len()) {
            if *is_counted {
                let mean = self.sums[index] / frames;
                let variance = (self.squares[index] / frames - mean * mean).max(0.0);
                sum += variance.sqrt() / mean.max(least);
                count += 1;
            }
        }
        sum / f64::from(count.max(1))
    }

    /// Largest mean among the pixels within reach of each.
    pub fn brightest_nearby(&self, reach: i32) -> Vec<f32> {
        let means: Vec<f64> = self.means().collect();
        let size = self.size.as_ivec2();
        let brightest = |x: i32, y: i32| {
            let columns = (x - reach).max(0)..=(x + reach).min(size.x - 1);
            let rows = (y - reach).max(0)..=(y + reach).min(size.y - 1);
            let nearby = rows.flat_map(|row| columns.clone().map(move |column| (row * size.x + column) as usize));
            nearby.map(|index| means[index]).fold(0.0, f64::max) as f32
        };
        let pixels = (0..size.y).flat_map(|y| (0..size.x).map(move |x| (x, y)));
        pixels.map(|(x, y)| brightest(x, y)).collect()
    }
}

/// A floor with objects on it, under a white sky or in the dark.
fn random(harness: &mut Harness, seed: u64, size: UVec2) -> StaticSceneView {
    let mut random = Random::new(seed);
    let environment = environment(SceneName::Furnace, harness.world());
    let root = harness.world().spawn((Transform::IDENTITY, Visibility::default()));
    let root = root.id();
    let surface = |random: &mut Random| StandardMaterial {
        base_color: Color::linear_rgb(random.range(0.1, 0.9), random.range(0.1, 0.9), random.range(0.1, 0.9)),
        perceptual_roughness: random.range(0.0, 1.0),
        metallic: random.pick(&[0.0, 1.0]),
        ..default()
    };
    let flat = Transform::from_rotation(Quat::from_rotation_x(-core::f32::consts::FRAC_PI_2));
    harness.spawn_objects(root, Rectangle::new(8.0, 8.0), surface(&mut random), [flat]);
    for index in 0..10 {
        let position = Vec3::new(random.range(-1.6, 1.6), random.range(0.2, 0.9), random.range(-1.4, 0.8));
        let mut material = surface(&mut random);
        // Lamps large enough for rays to find them.
        if index % 4 == 0 {
            let glow = random.range(0.5, 6.0);
            material.emissive = LinearRgba::rgb(glow, 0.8 * glow, 0.5 * glow);
        }
        let mesh: Mesh = if random.chance(0.5) {
            Cuboid::from_length(random.range(0.2, 0.6)).into()
        } else {
            Sphere::new(random.range(0.1, 0.35)).mesh().uv(24, 16)
        };
        harness.spawn_objects(root, mesh, material, [Transform::from_translation(position)]);
    }
    let eye = Transform::from_xyz(0.4, 1.4, 3.6).looking_at(Vec3::new(0.0, 0.3, 0.0), Vec3::Y);
    let exposure: Exposure = environment.exposure;
    let camera = harness.spawn_camera(size, (eye, exposure, ChildOf(root)));
    if random.chance(0.5) {
        environment.insert(&mut harness.world().entity_mut(camera));
    } else {
        let dark = AmbientLight {
            brightness: 0.0,
            ..default()
        };
        let black = Camera {
            clear_color: ClearColorConfig::Custom(Color::BLACK),
            ..default()
        };
        harness.world().entity_mut(camera).insert((dark, black));
    }
    StaticSceneView { root, camera }
}

/// The techniques that this harness can trace.
pub fn techniques(harness: &Harness) -> Vec<&'static str> {
    let inline = harness.has_inline_rays();
    let traces = |name: &&str| {
        let technique = named_settings(name).map(|(settings, _)| settings.technique);
        inline || technique != Ok(ReflectionTechnique::QuarterInline)
    };
    TECHNIQUES.iter().copied().filter(traces).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(values: [f32; 2]) -> LinearImage {
        LinearImage {
            size: UVec2::new(2, 1),
            texels: values.map(|value| [value, value, value, 1.0]).into(),
        }
    }

    #[test]
    fn averages_are_correct() {
        let mut average = Average::default();
        average.add(&gray([1.0, 3.0]));
        average.add(&gray([3.0, 3.0]));
        let near = |a: f64, b: f64| (a - b).abs() < 1e-5;
        let means: Vec<_> = average.means().collect();
        assert!(near(means[0], 2.0) && near(means[1], 3.0), "{means:?}");
        assert!(near(average.mean(), 2.5));
        // The first pixel deviates by 1 from 2, and the second doesn't deviate.
        assert!(near(average.flicker(&[true, true], 0.0), 0.25));
        assert!(near(average.flicker(&[true, false], 0.0), 0.5));
        // Relative to twice the mean of all.
        assert!(near(average.flicker(&[true, false], 2.0), 0.2));
        assert_eq!(average.flicker(&[false, false], 0.0), 0.0);
        assert_eq!(average.lit(1.0), [false, true]);
        let nearby = |reach: i32| average.brightest_nearby(reach);
        assert!(nearby(1).iter().all(|brightest| (brightest - 3.0).abs() < 1e-5));
        assert!((nearby(0)[0] - 2.0).abs() < 1e-5);
        assert!((average.brightest[0] - 3.0).abs() < 1e-5);
    }
}
