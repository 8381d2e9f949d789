//! Known scenes that stand still, and pictures of them averaged over frames: what the checks of energy and of flicker share.

use crate::{picture::luminance, random::Random, stage::Stage};
use bevy::{camera::Exposure, core_pipeline::tonemapping::Tonemapping, prelude::*};
use bevy_glint::{DebugView, RayTracedReflections, Technique, named_settings};
use glint_scenes::{SceneName, SceneOptions, environment};

/// Frames that loading, compiling and building may take.
const PATIENCE: u32 = 5000;

/// Techniques of the measurements that share one denoiser, then presets.
pub const TECHNIQUES: [&str; 8] = [
    "reference",
    "quarter",
    "quarter-inline",
    "vrs-roughness",
    "vrs-grazing",
    "vrs-combined",
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
        let (mut settings, heuristic) = named_settings(name).map_err(|error| error.to_string())?;
        settings.roughness_cutoff = 1.0;
        settings.roughness_fade = 0.0;
        let mut camera = stage.world().entity_mut(self.camera);
        camera.insert((settings, heuristic, view, Tonemapping::None));
        let settled = stage.settle(PATIENCE);
        if let Some(mut reflections) = stage.world().get_mut::<RayTracedReflections>(self.camera) {
            reflections.reset = true;
        }
        Ok(settled)
    }

    /// Renders frames and gathers their luminances.
    ///
    /// # Errors
    ///
    /// If a picture can't be read, or has pixels that are no numbers.
    pub fn average(&self, stage: &mut Stage, frames: u32) -> Result<Average, String> {
        let mut average = Average::default();
        for frame in 0..frames {
            stage.step(1);
            let picture = stage.picture(self.camera)?;
            if let Some(index) = picture.non_finite().first() {
                return Err(format!("pixel {index} of frame {frame} is no number"));
            }
            average.size = picture.size;
            average.add(picture.texels.iter().map(luminance));
        }
        Ok(average)
    }

    /// The luminances of one more frame.
    ///
    /// # Errors
    ///
    /// As [`average`](Self::average).
    pub fn frame(&self, stage: &mut Stage) -> Result<Vec<f32>, String> {
        let average = self.average(stage, 1)?;
        Ok(average.means().map(|mean| mean as f32).collect())
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

/// Luminances of a picture over frames.
#[derive(Clone, Debug, Default)]
pub struct Average {
    /// Pixels of the picture.
    pub size: UVec2,
    sums: Vec<f64>,
    squares: Vec<f64>,
    frame_means: Vec<f64>,
}

impl Average {
    fn add(&mut self, luminances: impl Iterator<Item = f32>) {
        let values: Vec<f64> = luminances.map(f64::from).collect();
        self.sums.resize(values.len(), 0.0);
        self.squares.resize(values.len(), 0.0);
        for (index, value) in values.iter().enumerate() {
            self.sums[index] += value;
            self.squares[index] += value * value;
        }
        self.frame_means
            .push(values.iter().sum::<f64>() / values.len().max(1) as f64);
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

    /// Standard error of that mean, from how the frames differ; neighbours in time are alike where there is a history, so that this
    /// is less than the whole of it.
    #[must_use]
    pub fn error(&self) -> f64 {
        let mean = self.mean();
        let square = self
            .frame_means
            .iter()
            .map(|frame| (frame - mean) * (frame - mean))
            .sum::<f64>();
        (square / self.frames() / (self.frames() - 1.0).max(1.0)).sqrt()
    }

    /// Mean over the pixels of their standard deviation from frame to frame, relative to the mean of all.
    #[must_use]
    pub fn flicker(&self) -> f64 {
        let frames = self.frames();
        let deviation = |(sum, square): (&f64, &f64)| (square / frames - sum * sum / (frames * frames)).max(0.0).sqrt();
        let sum: f64 = self.sums.iter().zip(&self.squares).map(deviation).sum();
        sum / self.sums.len().max(1) as f64 / self.mean().abs().max(1e-6)
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

    #[test]
    fn averages_are_what_they_say() {
        let mut average = Average {
            size: UVec2::new(2, 1),
            ..Average::default()
        };
        average.add([1.0, 3.0].into_iter());
        average.add([3.0, 3.0].into_iter());
        assert_eq!(average.means().collect::<Vec<_>>(), [2.0, 3.0]);
        assert_eq!(average.mean(), 2.5);
        // The first pixel deviates by 1, the second by nothing.
        assert!((average.flicker() - 0.5 / 2.5).abs() < 1e-9);
        assert!((average.error() - 0.5).abs() < 1e-9);
        assert_eq!(average.brightest_around(1), [3.0, 3.0]);
        assert_eq!(average.brightest_around(0), [2.0, 3.0]);
    }
}
