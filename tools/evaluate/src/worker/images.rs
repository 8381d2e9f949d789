//! Takes the images of all techniques, and the ground truth that they are compared with.

use super::{
    ground_truth::{Converged, GroundTruth},
    runner::{Runner, TIME_STEP},
    writer::ImageWriter,
};
use crate::{
    compare::{
        decomposition::decompose,
        image::{not_finite, save},
        reflected_light::{Surroundings, TrueLight},
    },
    files::write_json,
    job::{ImageKind, Variant, image_file},
    message::Message,
    protocol::{CLEAR_FRAMES, FLOAT_FRAMES, LEAD_FRAMES, Protocol, RECOVERY_FRAMES, SHARED_FRAMES, STATIC_FRAMES},
    state::{Captured, ShownSums, Store, ViewSplit},
    techniques,
};
use bevy::{camera::Exposure, core_pipeline::tonemapping::Tonemapping, prelude::*};
use image::RgbImage;
use std::{
    path::PathBuf,
    time::{SystemTime, UNIX_EPOCH},
};

/// Frames of the ground truth between two messages about progress.
const CHUNK: u32 = 16;
/// Radiance of the fog that encodes distances: far above the radiance of any surface, and within the range of half floats.
const FOG: f32 = 60_000.0;

/// Linear luminance of a view by a technique, for each run.
#[derive(Default)]
struct LightFrames {
    /// After some frames of motion.
    motion: Vec<Vec<f32>>,
    /// After a number of static frames.
    still: Vec<Vec<f32>>,
}

impl Runner<'_> {
    /// The ground truth of each view, and each view without any reflection of the environment.
    pub fn ground_truths(&mut self) -> Result<(), String> {
        let job = self.job;
        if !job.first {
            return Ok(());
        }
        for view in 0..job.protocol.views {
            let (folder, seconds) = (job.shared_images(view), self.scene.view(view));
            let dark = folder.join("dark.png");
            if dark.exists() {
                Message::Skipped(LEAD_FRAMES.into()).send();
            } else {
                let black = self.black.clone();
                self.in_environment(seconds, &black)?;
                save(&self.capture()?, &dark)?;
                self.leave_environment();
            }
            let (file, light) = (folder.join("converged.png"), job.true_light(view));
            let sums = Store::shared(job).true_sums(view);
            if file.exists() && light.exists() && sums.exists() {
                Message::Skipped(job.protocol.truth_frames() + u64::from(SHARED_FRAMES - LEAD_FRAMES)).send();
                continue;
            }
            let (pose, projection) = (self.scene.pose(seconds), self.scene.projection(seconds));
            let place = format!("{pose:?} {projection:?} after {seconds} s");
            let truth = GroundTruth::new(job, &self.scene.key(), &place, &self.adapter);
            let converged = if let Some(converged) = truth.load() {
                Message::Skipped(job.protocol.truth_frames()).send();
                converged
            } else {
                Message::Doing(format!("ground truth of view {view}")).send();
                let converged = self.converge(seconds)?;
                truth.save(&converged)?;
                converged
            };
            save(&converged.image, &file)?;
            let true_light = self.true_light(seconds, converged.halves)?;
            true_light.write(&light)?;
            write_json(&sums, &true_light.sums())?;
        }
        Ok(())
    }

    /// A view in Bevy's own lighting with another environment to reflect.
    fn in_environment(&mut self, seconds: f32, specular_map: &Handle<Image>) -> Result<(), String> {
        self.switch(&Variant::new("off"))?;
        self.pose(seconds);
        let specular_map = specular_map.clone();
        let world = self.app.world();
        let light = match world.get::<EnvironmentMapLight>(self.camera).cloned() {
            Some(light) => EnvironmentMapLight { specular_map, ..light },
            // Brightness that the camera shows as 1.
            None => EnvironmentMapLight {
                diffuse_map: self.black.clone(),
                specular_map,
                intensity: world
                    .get::<Exposure>(self.camera)
                    .map_or(1.0, |exposure| exposure.exposure().recip()),
                ..default()
            },
        };
        self.camera().insert(light);
        self.step(LEAD_FRAMES);
        Ok(())
    }

    /// The scene's own environment again.
    fn leave_environment(&mut self) {
        self.restore(self.environment.clone());
    }

    /// Gives the camera its own component back, or removes that of the measurement if it has none.
    fn restore<C: Component>(&mut self, own: Option<C>) {
        match own {
            Some(own) => self.camera().insert(own),
            None => self.camera().remove::<C>(),
        };
    }

    /// The light of a view, with the halves of its ground truth.
    ///
    /// The light that reflections add is the difference to a frame that traces like the ground truth and omits only the addition:
    /// everything else, such as light probes and the fraction of the environment that Bevy's lighting omitted, is the same in both.
    fn true_light(&mut self, seconds: f32, halves: [Vec<f32>; 2]) -> Result<TrueLight, String> {
        let white = self.white.clone();
        self.in_environment(seconds, &white)?;
        let in_white = self.capture_luminance()?;
        self.leave_environment();
        techniques::apply_truth(&mut self.camera());
        self.wait_until_ready(true)?;
        techniques::show_reflections(&mut self.app, false);
        self.step(LEAD_FRAMES);
        let without = self.capture_luminance();
        let in_fog = self.in_fog();
        techniques::show_reflections(&mut self.app, true);
        let (without, in_fog) = (without?, in_fog?);
        // Fog replaces a fraction of the light that grows with the distance. Pixels without fog, such as the sky, have no finite inverse,
        // and don't reflect.
        let pairs = without.iter().zip(&in_fog);
        let shares: Vec<f32> = pairs.map(|(without, fog)| (fog - without) / (FOG - without)).collect();
        let far = self.far();
        let metres: Vec<f32> = shares.iter().map(|share| far * share).collect();
        let surroundings = Surroundings {
            objects: self.objects(&metres),
            without,
            in_white,
            distance: shares,
        };
        Ok(TrueLight::new(self.job.protocol.width, surroundings, halves))
    }

    /// Distance at which the camera's view ends, in metres.
    fn far(&mut self) -> f32 {
        let projection = self.app.world().get::<Projection>(self.camera);
        projection.map_or(1000.0, |projection| projection.far())
    }

    /// Renders the last frame again in bright fog, which gives the distance of each pixel.
    fn in_fog(&mut self) -> Result<Vec<f32>, String> {
        let world = self.app.world();
        let own = world.get::<DistanceFog>(self.camera).cloned();
        let end = self.far();
        self.camera().insert(DistanceFog {
            color: Color::linear_rgb(FOG, FOG, FOG),
            falloff: FogFalloff::Linear { start: 0.0, end },
            ..default()
        });
        self.wait_until_ready(true)?;
        self.step(LEAD_FRAMES);
        let frame = self.capture_luminance();
        self.restore(own);
        frame
    }

    fn converge(&mut self, seconds: f32) -> Result<Converged, String> {
        techniques::apply_truth(&mut self.camera());
        self.pose(seconds);
        self.wait_until_ready(true)?;
        self.step(LEAD_FRAMES);
        techniques::reset(&mut self.camera());
        let samples = self.job.protocol.samples.max(2);
        self.accumulate(samples / 2);
        let first = self.capture_luminance()?;
        self.accumulate(samples - samples / 2);
        let all = self.capture_luminance()?;
        // The mean of all samples contains that of the first half, and the rest is the second half.
        let share = (samples / 2) as f32 / samples as f32;
        let pairs = all.iter().zip(&first);
        let second = pairs
            .map(|(all, first)| (all - share * first) / (1.0 - share))
            .collect();
        Ok(Converged {
            image: self.capture()?,
            halves: [first, second],
        })
    }

    /// Renders frames of the ground truth.
    fn accumulate(&mut self, mut left: u32) {
        while left > 0 {
            let chunk = left.min(CHUNK);
            self.step(chunk);
            left -= chunk;
        }
    }

    /// The images of all techniques.
    pub fn images(&mut self) -> Result<(), String> {
        let job = self.job;
        for variant in job.image_order() {
            let file = self.store.captured(variant);
            if file.exists() || self.store.failures().contains_key(&variant.id()) {
                Message::Skipped(job.protocol.image_frames()).send();
                continue;
            }
            self.begin(variant, format!("images of {variant}"))?;
            match self.images_of(variant) {
                Ok(captured) => {
                    write_json(&file, &captured)?;
                    Message::Captured.send();
                }
                Err(reason) => self.store.fail(&variant.id(), &reason)?,
            }
        }
        self.end();
        Ok(())
    }

    fn file(&self, view: u32, variant: &Variant, kind: ImageKind) -> PathBuf {
        image_file(&self.job.images(view), &variant.id(), kind)
    }

    fn images_of(&mut self, variant: &Variant) -> Result<Captured, String> {
        let protocol = &self.job.protocol;
        let writer = ImageWriter::start();
        let (mut nonfinite, mut light, mut splits) = (0, Vec::new(), Vec::new());
        self.prepare(variant)?;
        for view in 0..protocol.views {
            let mut shown = LightFrames::default();
            self.move_to_view(view, variant, 0)?;
            writer.save(self.file(view, variant, ImageKind::Final), self.capture()?);
            shown.motion.push(self.capture_luminance()?);
            if view < protocol.still_views {
                self.still_images(view, variant, &writer, &mut shown.still)?;
            }
            for run in 1..protocol.runs {
                self.move_to_view(view, variant, run)?;
                if !self.job.solari {
                    writer.save(self.file(view, variant, ImageKind::Run(run)), self.capture()?);
                }
                shown.motion.push(self.capture_luminance()?);
            }
            if view < protocol.float_views() {
                nonfinite += self.new_broken_pixels(view)?;
            }
            // Solari lights everything in its own way, so its difference to our frame without reflections contains more than reflections.
            if !self.job.solari {
                let truth = self.read_true_light(view)?;
                let save = |kind, image| writer.save(self.file(view, variant, kind), image);
                light.push(measure_light(&truth, &shown, save));
                if protocol.decompose {
                    splits.push(split(&truth, &shown, save));
                }
            }
        }
        let flicker = writer.finish()?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Captured {
            stamp: now.as_nanos() as u64,
            flicker,
            nonfinite,
            light,
            splits,
        })
    }

    /// Moves the camera to a view. The first run starts without any past. In further runs the technique stays switched on, so that its
    /// sequence of samples continues and they differ from the first only in their noise.
    pub fn move_to_view(&mut self, view: u32, variant: &Variant, run: u32) -> Result<(), String> {
        let frames = self.job.protocol.motion_frames;
        let seconds = self.scene.view(view);
        let earliest = self.scene.earliest(view);
        let before = |frames: u32| (seconds - frames as f32 * TIME_STEP).max(earliest);
        let start = before(frames);
        if run == 0 {
            self.clear(start)?;
            self.switch(variant)?;
        } else {
            self.pose(start);
            techniques::reset(&mut self.camera());
            self.step(CLEAR_FRAMES);
            techniques::reset(&mut self.camera());
        }
        // The last frame shows the exact instant of the ground truth.
        for left in (0..frames).rev() {
            self.pose(before(left));
            self.step(1);
        }
        Ok(())
    }

    /// A camera cut to a view, recovery from it, the remaining noise, and the light of static frames. All the while the clock of the
    /// scene is stopped at the time of the ground truth.
    fn still_images(
        &mut self,
        view: u32,
        variant: &Variant,
        writer: &ImageWriter,
        light: &mut Vec<Vec<f32>>,
    ) -> Result<(), String> {
        let protocol = &self.job.protocol;
        let seconds = self.scene.view(view);
        let elsewhere = self.scene.view((view + 1) % protocol.views);
        let start = self.scene.start();
        self.pose_apart(if protocol.views > 1 { elsewhere } else { start }, seconds);
        self.step(LEAD_FRAMES);
        self.pose(seconds);
        techniques::reset(&mut self.camera());
        let [.., last] = RECOVERY_FRAMES;
        for frame in 1..=last {
            self.step(1);
            if RECOVERY_FRAMES.contains(&frame) {
                let file = self.file(view, variant, ImageKind::Recovery(frame));
                writer.save(file, self.capture()?);
            }
        }
        let mut frames = vec![self.capture()?];
        for _ in 0..protocol.flicker_frames {
            self.step(1);
            frames.push(self.capture()?);
        }
        writer.flicker(frames);
        self.step(STATIC_FRAMES.saturating_sub(last + protocol.flicker_frames));
        light.push(self.capture_luminance()?);
        for _ in 1..protocol.runs {
            // The sequence of samples continues.
            techniques::reset(&mut self.camera());
            self.step(STATIC_FRAMES);
            light.push(self.capture_luminance()?);
        }
        Ok(())
    }

    fn read_true_light(&self, view: u32) -> Result<TrueLight, String> {
        let Protocol { width, height, .. } = self.job.protocol;
        let file = self.job.true_light(view);
        TrueLight::read(&file, width, height).ok_or_else(|| format!("{} can't be read", file.display()))
    }

    /// The number of the frame's broken pixels that are intact without reflections.
    fn new_broken_pixels(&mut self, view: u32) -> Result<u64, String> {
        let broken = self.broken_pixels()?;
        let before = match self.broken.get(&view) {
            Some(before) => before.clone(),
            None => {
                self.clear(self.scene.view(view))?;
                let before = self.broken_pixels()?;
                self.broken.insert(view, before.clone());
                before
            }
        };
        let new = broken.iter().zip(&before).filter(|(now, before)| **now && !**before);
        Ok(new.count() as u64)
    }

    /// Flags of the frame's pixels that are infinite or NaN before tone mapping.
    fn broken_pixels(&mut self) -> Result<Vec<bool>, String> {
        let target = self.float_target.clone();
        self.camera().insert((target.clone(), Tonemapping::None));
        self.step(FLOAT_FRAMES);
        let bytes = self.app.read_target(&target).map_err(|error| error.to_string());
        let usual = (self.app.target(), self.tonemapping);
        self.camera().insert(usual);
        Ok(not_finite(&bytes?))
    }
}

/// Sums and maps of the reflected light of a technique in a view.
fn measure_light(truth: &TrueLight, shown: &LightFrames, save: impl Fn(ImageKind, RgbImage)) -> ShownSums {
    for (frames, kind) in [
        (&shown.motion, ImageKind::LightInMotion),
        (&shown.still, ImageKind::StaticLight),
    ] {
        if !frames.is_empty() {
            save(kind, truth.map(frames));
        }
    }
    let sums = |frames: &[Vec<f32>]| frames.iter().map(|frame| truth.shown(frame)).collect();
    ShownSums {
        motion: sums(&shown.motion),
        still: sums(&shown.still),
    }
}

/// Noise and bias of the reflected light of a technique in a view, with maps of both in motion.
fn split(truth: &TrueLight, shown: &LightFrames, save: impl Fn(ImageKind, RgbImage)) -> ViewSplit {
    let motion = decompose(truth, &shown.motion).map(|found| {
        save(ImageKind::Noise, found.noise);
        save(ImageKind::Bias, found.bias);
        found.split
    });
    ViewSplit {
        motion,
        still: decompose(truth, &shown.still).map(|found| found.split),
    }
}
