//! Known scenes that stand still, and pictures of them averaged over frames: what the checks of energy and of flicker share.

use crate::{
    picture::{Picture, luminance},
    random::Random,
    stage::Stage,
};
use bevy::{camera::Exposure, core_pipeline::tonemapping::Tonemapping, prelude::*};
use bevy_glint::{DebugView, RayTracedReflections, ShadingRateHeuristic, Technique, named_settings};
use glint_scenes::{SceneName, SceneOptions, environment};

/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 5000;

/// Techniques of the measurements that share one denoiser, the finest first, then presets.
pub const TECHNIQUES: [&str; 8] = [
    "reference",
    "vrs-combined",
    "vrs-roughness",
    "vrs-grazing",
    "quarter",
    "quarter-inline",
    "paper",
    "ultra",
];

/// A scene that stands still.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StillScene {
    /// One of the built-in scenes.
    BuiltIn(SceneName),
    /// Boxes and balls of all materials, small lamps and glowing panels, strewn at random.
    Random(u64),
}

impl StillScene {
    /// The word for reports.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::BuiltIn(name) => name.as_str().to_owned(),
            Self::Random(seed) => format!("random {seed}"),
        }
    }
}

/// A scene with a camera that shows the reflection alone.
pub struct StillView {
    root: Entity,
    /// The camera.
    pub camera: Entity,
}

impl StillView {
    /// Spawns a scene; its clock stands still.
    pub fn new(stage: &mut Stage, scene: StillScene, size: UVec2) -> Self {
        stage.reset_clocks();
        stage.world().resource_mut::<Time<Virtual>>().pause();
        match scene {
            StillScene::BuiltIn(name) => built_in(stage, name, size),
            StillScene::Random(seed) => strewn(stage, seed, size),
        }
    }

    /// Switches to a technique without a cut-off, with its history empty; false if it can't be compiled.
    ///
    /// # Errors
    ///
    /// If there is no technique of that name.
    pub fn switch(&self, stage: &mut Stage, name: &str, view: DebugView) -> Result<bool, String> {
        Ok(self.show(stage, without_cut_off(name)?, view))
    }

    /// The same without a history at all: frames then differ by all the noise of their rays, independently of each other.
    ///
    /// # Errors
    ///
    /// If there is no technique of that name.
    pub fn switch_to_single_frames(&self, stage: &mut Stage, name: &str, view: DebugView) -> Result<bool, String> {
        let (mut settings, heuristic) = without_cut_off(name)?;
        settings.denoiser.temporal = false;
        Ok(self.show(stage, (settings, heuristic), view))
    }

    fn show(&self, stage: &mut Stage, settings: (RayTracedReflections, ShadingRateHeuristic), view: DebugView) -> bool {
        let mut camera = stage.world().entity_mut(self.camera);
        camera.insert((settings, view, Tonemapping::None));
        let settled = stage.settle(PATIENCE);
        if let Some(mut reflections) = stage.world().get_mut::<RayTracedReflections>(self.camera) {
            reflections.reset = true;
        }
        settled
    }

    /// Renders frames and hands each picture on.
    ///
    /// # Errors
    ///
    /// If a picture can't be read, or has pixels that are no numbers.
    pub fn watch(&self, stage: &mut Stage, frames: u32, mut look: impl FnMut(&Picture)) -> Result<(), String> {
        for frame in 0..frames {
            stage.step(1);
            let picture = stage.picture(self.camera)?;
            if let Some(index) = picture.non_finite().first() {
                return Err(format!("pixel {index} of frame {frame} is no number"));
            }
            look(&picture);
        }
        Ok(())
    }

    /// Renders frames and gathers their luminances.
    ///
    /// # Errors
    ///
    /// As [`watch`](Self::watch).
    pub fn average(&self, stage: &mut Stage, frames: u32) -> Result<Average, String> {
        let mut average = Average::default();
        self.watch(stage, frames, |picture| average.add(picture))?;
        Ok(average)
    }

    /// Despawns all.
    pub fn remove(self, stage: &mut Stage) {
        let world = stage.world();
        world.despawn(self.camera);
        world.despawn(self.root);
        stage.step(2);
        stage.reset_clocks();
    }
}

/// Settings of a technique that reflects on surfaces of any roughness.
fn without_cut_off(name: &str) -> Result<(RayTracedReflections, ShadingRateHeuristic), String> {
    let (mut settings, heuristic) = named_settings(name).map_err(|error| error.to_string())?;
    settings.roughness_cutoff = 1.0;
    settings.roughness_fade = 0.0;
    Ok((settings, heuristic))
}

/// Luminances of a picture over frames.
#[derive(Clone, Debug, Default)]
pub struct Average {
    /// Pixels of the picture.
    pub size: UVec2,
    /// Mean of each frame.
    pub frame_means: Vec<f64>,
    /// The brightest that each pixel was in any frame.
    pub brightest: Vec<f32>,
    sums: Vec<f64>,
    squares: Vec<f64>,
}

impl Average {
    /// Adds a frame; all must be of one size.
    pub fn add(&mut self, picture: &Picture) {
        self.size = picture.size;
        let count = picture.texels.len();
        self.sums.resize(count, 0.0);
        self.squares.resize(count, 0.0);
        self.brightest.resize(count, f32::NEG_INFINITY);
        let mut sum = 0.0;
        for (index, texel) in picture.texels.iter().enumerate() {
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
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.frame_means.iter().sum::<f64>() / self.frames()
    }

    /// The pixels that show a reflection: at least so much of the mean of all.
    #[must_use]
    pub fn lit(&self, share: f64) -> Vec<bool> {
        let least = (share * self.mean()).max(1e-6);
        self.means().map(|mean| mean >= least).collect()
    }

    /// How much pixels flicker, on average over some of them: their standard deviation from frame to frame over their mean. Dark pixels
    /// are measured against so much of the mean of all, since nobody sees theirs.
    #[must_use]
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

    /// The brightest mean among the pixels around each.
    #[must_use]
    pub fn brightest_around(&self, reach: i32) -> Vec<f32> {
        let means: Vec<f64> = self.means().collect();
        let size = self.size.as_ivec2();
        let brightest = |x: i32, y: i32| {
            let columns = (x - reach).max(0)..=(x + reach).min(size.x - 1);
            let rows = (y - reach).max(0)..=(y + reach).min(size.y - 1);
            let around = rows.flat_map(|row| columns.clone().map(move |column| (row * size.x + column) as usize));
            around.map(|index| means[index]).fold(0.0, f64::max) as f32
        };
        let places = (0..size.y).flat_map(|y| (0..size.x).map(move |x| (x, y)));
        places.map(|(x, y)| brightest(x, y)).collect()
    }
}

fn built_in(stage: &mut Stage, name: SceneName, size: UVec2) -> StillView {
    let options = SceneOptions {
        texture_size: 64,
        ..default()
    };
    let root = glint_scenes::spawn_with(name, stage.world(), &options);
    let (transform, projection) = glint_scenes::camera(name);
    let camera = stage.spawn_camera(size, (transform, Projection::from(projection)));
    let environment = environment(name, stage.world());
    environment.insert(&mut stage.world().entity_mut(camera));
    StillView { root, camera }
}

/// A floor with things on it, under a white sky or in the dark.
fn strewn(stage: &mut Stage, seed: u64, size: UVec2) -> StillView {
    let mut random = Random::new(seed);
    let environment = environment(SceneName::Furnace, stage.world());
    let world = stage.world();
    let root = world.spawn((Transform::IDENTITY, Visibility::default())).id();
    let mut add = |mesh: Mesh, material: StandardMaterial, at: Transform| {
        let mesh = world.resource_mut::<Assets<Mesh>>().add(mesh);
        let material = world.resource_mut::<Assets<StandardMaterial>>().add(material);
        world.spawn((Mesh3d(mesh), MeshMaterial3d(material), at, ChildOf(root)));
    };
    let surface = |random: &mut Random| StandardMaterial {
        base_color: Color::linear_rgb(random.range(0.1, 0.9), random.range(0.1, 0.9), random.range(0.1, 0.9)),
        perceptual_roughness: random.range(0.0, 1.0),
        metallic: random.pick(&[0.0, 1.0]),
        ..default()
    };
    let flat = Transform::from_rotation(Quat::from_rotation_x(-core::f32::consts::FRAC_PI_2));
    add(Rectangle::new(8.0, 8.0).into(), surface(&mut random), flat);
    for index in 0..10 {
        let place = Vec3::new(random.range(-1.6, 1.6), random.range(0.2, 0.9), random.range(-1.4, 0.8));
        let mut material = surface(&mut random);
        // Lamps of a size that rays find.
        if index % 4 == 0 {
            let glow = random.range(0.5, 6.0);
            material.emissive = LinearRgba::rgb(glow, 0.8 * glow, 0.5 * glow);
        }
        let mesh = if random.chance(0.5) {
            Cuboid::from_length(random.range(0.2, 0.6)).into()
        } else {
            Sphere::new(random.range(0.1, 0.35)).mesh().uv(24, 16)
        };
        add(mesh, material, Transform::from_translation(place));
    }
    let eye = Transform::from_xyz(0.4, 1.4, 3.6).looking_at(Vec3::new(0.0, 0.3, 0.0), Vec3::Y);
    let exposure: Exposure = environment.exposure;
    let camera = stage.spawn_camera(size, (eye, exposure, ChildOf(root)));
    if random.chance(0.5) {
        environment.insert(&mut stage.world().entity_mut(camera));
    } else {
        let dark = AmbientLight {
            brightness: 0.0,
            ..default()
        };
        let black = Camera {
            clear_color: ClearColorConfig::Custom(Color::BLACK),
            ..default()
        };
        stage.world().entity_mut(camera).insert((dark, black));
    }
    StillView { root, camera }
}

/// The techniques that this stage can trace.
#[must_use]
pub fn techniques(stage: &Stage) -> Vec<&'static str> {
    let inline = stage.has_inline_rays();
    let traces = |name: &&str| {
        let technique = named_settings(name).map(|(settings, _)| settings.technique);
        inline || technique != Ok(Technique::QuarterInline)
    };
    TECHNIQUES.iter().copied().filter(traces).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(values: [f32; 2]) -> Picture {
        Picture {
            size: UVec2::new(2, 1),
            texels: values.map(|value| [value, value, value, 1.0]).into(),
        }
    }

    #[test]
    fn averages_are_what_they_say() {
        let mut average = Average::default();
        average.add(&gray([1.0, 3.0]));
        average.add(&gray([3.0, 3.0]));
        let near = |a: f64, b: f64| (a - b).abs() < 1e-5;
        assert!(
            average
                .means()
                .zip([2.0, 3.0])
                .all(|(mean, expected)| near(mean, expected))
        );
        assert!(near(average.mean(), 2.5));
        // The first pixel deviates by 1 from 2, the second by nothing.
        assert!(near(average.flicker(&[true, true], 0.0), 0.25));
        assert!(near(average.flicker(&[true, false], 0.0), 0.5));
        // Measured against twice the mean of all.
        assert!(near(average.flicker(&[true, false], 2.0), 0.2));
        assert_eq!(average.flicker(&[false, false], 0.0), 0.0);
        assert_eq!(average.lit(1.0), [false, true]);
        let around = |reach: i32| average.brightest_around(reach);
        assert!(around(1).iter().all(|brightest| (brightest - 3.0).abs() < 1e-5));
        assert!((around(0)[0] - 2.0).abs() < 1e-5);
        assert!((average.brightest[0] - 3.0).abs() < 1e-5);
    }
}
