//! Takes the images of all techniques, and the ground truth that they are compared with.

use super::{
    ground_truth::GroundTruth,
    runner::{Runner, TIME_STEP},
    writer::ImageWriter,
};
use crate::{
    compare::image::{not_finite, save},
    files::write_json,
    job::{ImageKind, Variant, image_file},
    message::Message,
    protocol::{FLOAT_FRAMES, LEAD_FRAMES, RECOVERY_FRAMES},
    state::Captured,
    techniques,
};
use bevy::{core_pipeline::tonemapping::Tonemapping, prelude::*};
use image::RgbImage;
use std::{
    path::PathBuf,
    time::{SystemTime, UNIX_EPOCH},
};

/// Frames of the ground truth between two messages about progress.
const CHUNK: u32 = 16;

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
                save(&self.dark(seconds)?, &dark)?;
            }
            let file = folder.join("converged.png");
            if file.exists() {
                Message::Skipped(job.protocol.truth_frames()).send();
                continue;
            }
            let place = format!("{:?} after {seconds} s", self.scene.pose(seconds));
            let truth = GroundTruth::new(job, &self.scene.key(), &place, &self.adapter);
            let image = if let Some(image) = truth.load() {
                Message::Skipped(job.protocol.truth_frames()).send();
                image
            } else {
                Message::Doing(format!("ground truth of view {view}")).send();
                let image = self.converge(seconds)?;
                truth.save(&image)?;
                image
            };
            save(&image, &file)?;
        }
        Ok(())
    }

    /// A view without any reflection.
    fn dark(&mut self, seconds: f32) -> Result<RgbImage, String> {
        self.switch(&Variant::new("off"))?;
        self.pose(seconds);
        let light = self.app.world().get::<EnvironmentMapLight>(self.camera).cloned();
        if let Some(light) = light.clone() {
            let specular_map = self.black.clone();
            self.camera().insert(EnvironmentMapLight { specular_map, ..light });
        }
        self.step(LEAD_FRAMES);
        let image = self.capture();
        if let Some(light) = light {
            self.camera().insert(light);
        }
        image
    }

    fn converge(&mut self, seconds: f32) -> Result<RgbImage, String> {
        techniques::apply_truth(&mut self.camera());
        self.pose(seconds);
        self.wait_until_ready(true)?;
        self.step(LEAD_FRAMES);
        techniques::reset(&mut self.camera());
        let mut left = self.job.protocol.samples.max(1);
        while left > 0 {
            let chunk = left.min(CHUNK);
            self.step(chunk);
            left -= chunk;
        }
        self.capture()
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
        let mut nonfinite = 0;
        self.prepare(variant)?;
        for view in 0..protocol.views {
            let seconds = self.scene.view(view);
            let start = (seconds - protocol.motion_frames as f32 * TIME_STEP).max(0.0);
            self.clear(start)?;
            self.switch(variant)?;
            for frame in 1..=protocol.motion_frames {
                let share = frame as f32 / protocol.motion_frames as f32;
                self.pose(start + (seconds - start) * share);
                self.step(1);
            }
            writer.save(self.file(view, variant, ImageKind::Final), self.capture()?);
            if view < protocol.still_views {
                self.still_images(view, variant, &writer)?;
            }
            if view < protocol.float_views() {
                nonfinite += self.new_broken_pixels(view)?;
            }
        }
        let flicker = writer.finish()?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Captured {
            stamp: now.as_nanos() as u64,
            flicker,
            nonfinite,
        })
    }

    /// A camera cut to a view, recovery from it, and the noise that stays.
    fn still_images(&mut self, view: u32, variant: &Variant, writer: &ImageWriter) -> Result<(), String> {
        let protocol = &self.job.protocol;
        let seconds = self.scene.view(view);
        let elsewhere = self.scene.view((view + 1) % protocol.views);
        self.pose(if protocol.views > 1 { elsewhere } else { 0.0 });
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
        Ok(())
    }

    /// The number of broken pixels of the frame that are not broken without reflections.
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
