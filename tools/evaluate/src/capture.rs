//! Pictures of all techniques, and the ground truth that they are compared with.

use crate::{
    background::Background,
    picture::{Picture, not_finite},
    plan::{PictureKind, Variant, picture_file},
    protocol::{FLOAT_FRAMES, LEAD_FRAMES},
    report::Event,
    rows::RECOVERY_FRAMES,
    run::{FRAME_LIMIT, PATIENCE, Runner, TIME_STEP},
    state::{Captured, write_json},
    techniques,
    truth::Truth,
};
use bevy::{camera::RenderTarget, core_pipeline::tonemapping::Tonemapping, prelude::*, render::RenderApp};
use glint_scenes::read_image;
use std::{
    path::PathBuf,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// Frames of the ground truth between two lines about progress.
const CHUNK: u32 = 16;

impl Runner<'_> {
    /// The ground truth of each view, and each view without any reflection of the environment.
    pub(crate) fn truths(&mut self) -> Result<(), String> {
        let job = self.job;
        if !job.first {
            return Ok(());
        }
        for view in 0..job.protocol.views {
            let (folder, seconds) = (job.shared_pictures(view), self.stage.view(view));
            let dark = folder.join("dark.png");
            if dark.exists() {
                Event::Skipped(LEAD_FRAMES.into()).tell();
            } else {
                self.dark(seconds)?.save(&dark)?;
            }
            let file = folder.join("converged.png");
            if file.exists() {
                Event::Skipped(job.protocol.truth_frames()).tell();
                continue;
            }
            let place = format!("{:?} after {seconds} s", self.stage.pose(seconds));
            let truth = Truth::new(job, &self.stage.key(), &place, &self.adapter);
            if let Some(picture) = truth.load() {
                Event::Skipped(job.protocol.truth_frames()).tell();
                picture.save(&file)?;
                continue;
            }
            Event::Doing(format!("ground truth of view {view}")).tell();
            let picture = self.converge(seconds)?;
            truth.save(&picture)?;
            picture.save(&file)?;
        }
        Ok(())
    }

    fn dark(&mut self, seconds: f32) -> Result<Picture, String> {
        self.switch(&Variant::new("off"))?;
        self.pose(seconds);
        let black = self.black.clone();
        let light = self.app.world().get::<EnvironmentMapLight>(self.camera).cloned();
        if let Some(light) = &light {
            let specular_map = black;
            self.app.world().entity_mut(self.camera).insert(EnvironmentMapLight {
                specular_map,
                ..light.clone()
            });
        }
        self.step(LEAD_FRAMES);
        let picture = self.capture();
        if let Some(light) = light {
            self.app.world().entity_mut(self.camera).insert(light);
        }
        picture
    }

    fn converge(&mut self, seconds: f32) -> Result<Picture, String> {
        techniques::apply_truth(&mut self.app.world().entity_mut(self.camera));
        self.pose(seconds);
        self.app.warm_up(FRAME_LIMIT).map_err(|error| error.to_string())?;
        let start = Instant::now();
        while !self.report().ready {
            if start.elapsed() > PATIENCE {
                return Err("the pipelines of the ground truth were not ready in time".to_owned());
            }
            std::thread::sleep(Duration::from_millis(5));
            self.app.step(1);
        }
        self.step(LEAD_FRAMES);
        techniques::reset(&mut self.app.world().entity_mut(self.camera));
        let mut left = self.job.protocol.samples.max(1);
        while left > 0 {
            let chunk = left.min(CHUNK);
            self.step(chunk);
            left -= chunk;
        }
        self.capture()
    }

    /// The pictures of all techniques.
    pub(crate) fn pictures(&mut self) -> Result<(), String> {
        let job = self.job;
        for variant in job.picture_order() {
            let file = self.store.captured(variant);
            if file.exists() || self.store.failures().contains_key(&variant.id()) {
                Event::Skipped(job.protocol.picture_frames()).tell();
                continue;
            }
            self.begin(variant)?;
            Event::Doing(format!("pictures of {variant}")).tell();
            match self.pictures_of(variant) {
                Ok(captured) => {
                    write_json(&file, &captured)?;
                    Event::Captured(variant.id()).tell();
                }
                Err(reason) => self.store.fail(&variant.id(), &reason)?,
            }
        }
        self.end();
        Ok(())
    }

    fn file(&self, view: u32, variant: &Variant, kind: PictureKind) -> PathBuf {
        picture_file(&self.job.pictures(view), &variant.id(), kind)
    }

    fn pictures_of(&mut self, variant: &Variant) -> Result<Captured, String> {
        let protocol = &self.job.protocol;
        let background = Background::start();
        let mut nonfinite = 0;
        self.settle(variant)?;
        for view in 0..protocol.views {
            let seconds = self.stage.view(view);
            let start = (seconds - protocol.motion_frames as f32 * TIME_STEP).max(0.0);
            self.rest(start)?;
            self.switch(variant)?;
            for frame in 1..=protocol.motion_frames {
                let share = frame as f32 / protocol.motion_frames as f32;
                self.pose(start + (seconds - start) * share);
                self.step(1);
            }
            background.save(self.file(view, variant, PictureKind::Final), self.capture()?);
            if view < protocol.still_views {
                self.still_pictures(view, variant, &background)?;
            }
            if view < protocol.float_views() {
                nonfinite += self.new_broken_pixels(view)?;
            }
        }
        let flicker = background.finish()?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Captured {
            stamp: now.as_nanos() as u64,
            flicker,
            nonfinite,
        })
    }

    /// A camera cut to a view, recovery from it, and the noise that stays.
    fn still_pictures(&mut self, view: u32, variant: &Variant, background: &Background) -> Result<(), String> {
        let protocol = &self.job.protocol;
        let seconds = self.stage.view(view);
        let elsewhere = self.stage.view((view + 1) % protocol.views);
        self.pose(if protocol.views > 1 { elsewhere } else { 0.0 });
        self.step(LEAD_FRAMES);
        self.pose(seconds);
        techniques::reset(&mut self.app.world().entity_mut(self.camera));
        let [.., last] = RECOVERY_FRAMES;
        for frame in 1..=last {
            self.step(1);
            if RECOVERY_FRAMES.contains(&frame) {
                let file = self.file(view, variant, PictureKind::Recovery(frame));
                background.save(file, self.capture()?);
            }
        }
        let mut frames = vec![self.capture()?];
        for _ in 0..protocol.flicker_frames {
            self.step(1);
            frames.push(self.capture()?);
        }
        background.flicker(frames);
        Ok(())
    }

    /// How many pixels of the frame are broken that aren't without any reflections.
    fn new_broken_pixels(&mut self, view: u32) -> Result<u64, String> {
        let broken = self.broken_pixels()?;
        let before = match self.broken.get(&view) {
            Some(before) => before.clone(),
            None => {
                self.rest(self.stage.view(view))?;
                let before = self.broken_pixels()?;
                self.broken.insert(view, before.clone());
                before
            }
        };
        let new = broken.iter().zip(&before).filter(|(now, before)| **now && !**before);
        Ok(new.count() as u64)
    }

    /// Which pixels of the frame are infinite or no number before tone mapping.
    fn broken_pixels(&mut self) -> Result<Vec<bool>, String> {
        let target = self.float_target.clone();
        let mut camera = self.app.world().entity_mut(self.camera);
        camera.insert((RenderTarget::from(target.clone()), Tonemapping::None));
        self.step(FLOAT_FRAMES);
        let render = self.app.app().get_sub_app(RenderApp).ok_or("there is no renderer")?;
        let bytes = read_image(render.world(), &target).map_err(|error| error.to_string());
        let (usual, tonemapping) = (self.app.target(), self.tonemapping);
        self.app.world().entity_mut(self.camera).insert((usual, tonemapping));
        Ok(not_finite(&bytes?))
    }
}
