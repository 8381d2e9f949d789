//! The command line, and its jobs on this machine.

use crate::{
    job::{self, HELD_OUT_TECHNIQUES, HELD_OUT_VIEWS, Job, SCENES, SceneSource, TECHNIQUES, TracerName, Variant},
    machine::Machine,
    protocol::{DECOMPOSING_RUNS, PathFile, Protocol},
    techniques,
};
use clap::{Parser, ValueEnum};
use glint_scenes::{CameraPlace, ImageSize, RecordedPath, SceneName};
use std::path::{self, PathBuf};

/// Measure the cost of each technique and the error of its image.
#[derive(Parser, Clone, Debug, Default)]
#[command(name = "glint_evaluate")]
pub struct Arguments {
    /// Measure little: under 2 minutes on a GPU, under 10 on a CPU.
    #[arg(long)]
    pub quick: bool,
    /// Built-in scenes, separated by commas (default: atrium, temple and street).
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub scene: Vec<String>,
    /// Measure scenes that settings aren't tuned on: all of them unless scenes are named, in two views each, with the techniques of one
    /// comparison. Their table is also written to `held_out.md`.
    #[arg(long)]
    pub held_out: bool,
    /// A glTF file (.gltf or .glb), in place of or beside built-in scenes; can be given several times. Its own cameras are the views,
    /// unless others are given.
    #[arg(long, value_name = "FILE")]
    pub gltf: Vec<PathBuf>,
    /// Position of the camera and its target, in metres, in place of the scene's path; can be given several times, each is a view. One
    /// scene or file alone.
    #[arg(long, value_name = "X,Y,Z,TX,TY,TZ", allow_hyphen_values = true)]
    pub camera: Vec<CameraPlace>,
    /// A camera path that the viewer has recorded (its key F9), in place of the scene's. One scene or file alone.
    #[arg(long, value_name = "FILE", conflicts_with = "camera")]
    pub path: Option<PathBuf>,
    /// Size of the image, such as 1920x1080 (default: that on a GPU, less on a CPU or if quick).
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub size: Option<ImageSize>,
    /// Timed frames per technique (default: 5000 on a GPU, less on a CPU or if quick).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: Option<u32>,
    /// Views along the path to compare.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub views: Option<u32>,
    /// Samples per pixel of the ground truth. The difference of its two halves gives its noise.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    pub samples: Option<u32>,
    /// Runs that differ only in their noise, for the intervals of errors.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub runs: Option<u32>,
    /// Split the error of each technique's reflected light into noise (differs from run to run) and bias (doesn't: lag, blur, ghosts);
    /// takes at least 4 runs.
    #[arg(long)]
    pub decompose: bool,
    /// The back end, which turns the rate image into fewer rays.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = BackendWord::Auto)]
    pub backend: BackendWord,
    /// The tracer, which follows the rays.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = TracerWord::Auto)]
    pub tracer: TracerWord,
    /// Techniques and presets, separated by commas (default: all; fewer if quick).
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub techniques: Vec<String>,
    /// The folder of results. An interrupted run continues where it stopped.
    #[arg(long, value_name = "DIR", required_unless_present_any = ["job", "probe"])]
    pub out: Option<PathBuf>,
    /// The folder in which ground truths are kept from run to run (default: target/evaluate).
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// An older results.csv: lists changes beyond noise, and ends with status 3 if anything got slower or worse.
    #[arg(long, value_name = "FILE.csv")]
    pub compare: Option<PathBuf>,
    /// Shader modules that replace the crate's of the same path, to compare versions without building anew. The ground truth uses the
    /// crate's.
    #[arg(long, value_name = "DIR")]
    pub shaders: Option<PathBuf>,
    /// Forget earlier measurements in the folder of results.
    #[arg(long)]
    pub fresh: bool,
    /// Measure a job. Used by the tool itself.
    #[arg(long, hide = true, value_name = "FILE")]
    pub job: Option<PathBuf>,
    /// Rewrite tables, summary and charts from the results.json and results.csv in --out, without measuring, on any machine
    #[arg(long)]
    pub rewrite: bool,
    /// Print the least error of an image that takes each tile from one of two techniques, from the images in --out of at least 2 --runs
    #[arg(long, value_name = "NAME,NAME", value_delimiter = ',', requires = "runs")]
    pub mix: Vec<String>,
    /// Describe the machine. Used by the tool itself.
    #[arg(long, hide = true)]
    pub probe: bool,
}

/// Back ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum BackendWord {
    /// All that this machine has.
    #[default]
    #[value(alias = "all")]
    Auto,
    /// Lists of rays.
    Compute,
    /// The rasterizer's shading rate.
    Hardware,
}

/// Tracers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum TracerWord {
    /// Ray queries if the GPU has them, otherwise the BVH; the BVH if quick on a CPU.
    #[default]
    Auto,
    /// Ray queries.
    RayQuery,
    /// The crate's BVH.
    Bvh,
    /// All that this machine has.
    All,
}

/// A size at which FLIP and the denoiser are meaningful.
fn size(text: &str) -> Result<ImageSize, String> {
    let size: ImageSize = text.parse()?;
    if size.0.min_element() < 16 {
        return Err("images need at least 16 pixels each way".to_owned());
    }
    Ok(size)
}

/// The jobs of a run.
#[derive(Debug)]
pub struct MeasurementPlan {
    /// How much of it.
    pub protocol: Protocol,
    /// In this order.
    pub jobs: Vec<Job>,
    /// Variants that this machine can't run, each with a job that would have measured it, and the reason.
    pub skipped: Vec<(Job, Variant, String)>,
    /// The folder of results.
    pub out: PathBuf,
}

impl Arguments {
    /// The jobs that the command line requests on a machine.
    pub fn plan(&self, machine: &Machine) -> Result<MeasurementPlan, String> {
        let absolute = |path: PathBuf| {
            path::absolute(&path).map_err(|error| format!("{} can't be resolved: {error}", path.display()))
        };
        let out = absolute(self.out.clone().ok_or("--out is missing")?)?;
        let cache = absolute(self.cache.clone().unwrap_or_else(|| PathBuf::from("target/evaluate")))?;
        let mut protocol = self.protocol(machine)?;
        protocol.shaders = self.shaders.clone().map(absolute).transpose()?;
        let scenes = self.scenes()?;
        if scenes.len() > 1 && (self.path.is_some() || !self.camera.is_empty()) {
            return Err("--camera and --path belong to one scene: choose it by --scene NAME or --gltf FILE".to_owned());
        }
        let names = self.names()?;
        let backends = self.backends(machine)?;
        let tracers = self.tracers(machine)?;
        let (mut jobs, mut skipped) = (Vec::new(), Vec::new());
        for scene in scenes {
            let job = |tracer, solari, first| Job {
                scene: scene.clone(),
                tracer,
                solari,
                first,
                variants: Vec::new(),
                protocol: protocol.clone(),
                out: out.clone(),
                cache: cache.clone(),
            };
            for (index, tracer) in tracers.iter().enumerate() {
                let mut job = job(*tracer, false, index == 0);
                job.variants = self.variants(&names, backends, index > 0);
                jobs.push(job);
            }
            if names.contains(&"solari") {
                let mut job = job(TracerName::RayQuery, true, false);
                let solari = Variant::new("solari");
                if machine.ray_query {
                    job.variants.push(solari);
                    jobs.push(job);
                } else {
                    skipped.push((job, solari, "the GPU has no ray queries".to_owned()));
                }
            }
        }
        // The first job of a scene also makes the ground truth for the others.
        jobs.retain(|job: &Job| job.first || !job.variants.is_empty());
        Ok(MeasurementPlan {
            protocol,
            jobs,
            skipped,
            out,
        })
    }

    /// Techniques with their back ends, including compute and hardware if both are measured; `traced_only` omits techniques that don't
    /// trace.
    fn variants(&self, names: &[&str], (compute, hardware): (bool, bool), traced_only: bool) -> Vec<Variant> {
        let ours = names.iter().filter(|name| **name != "solari");
        let wanted = ours
            .map(|name| Variant::new(name))
            .filter(|variant| !traced_only || variant.traces());
        let both = wanted.flat_map(|variant| {
            let has_backends =
                techniques::has_backends(&variant.technique) && (!self.quick || variant.technique == "vrs-roughness");
            let with_hardware = (has_backends && hardware).then(|| Variant {
                hardware: true,
                ..variant.clone()
            });
            let plain = (!has_backends || compute).then_some(variant);
            plain.into_iter().chain(with_hardware)
        });
        both.collect()
    }

    fn protocol(&self, machine: &Machine) -> Result<Protocol, String> {
        let mut protocol = Protocol::new(self.quick, machine.is_cpu);
        if let Some(size) = self.size {
            (protocol.width, protocol.height) = size.0.into();
        }
        if let Some(frames) = self.frames {
            protocol.timing_frames = frames;
            // At least five rounds, so that ratios get an interval.
            protocol.block = protocol.block.min(frames.div_ceil(5)).max(1);
        }
        if let Some(views) = self.views.or(self.held_out.then_some(HELD_OUT_VIEWS)) {
            protocol.views = views;
            protocol.still_views = protocol.still_views.min(views);
        }
        if let Some(file) = &self.path {
            // An invalid path file is better rejected now than in a process for each scene.
            RecordedPath::load(file)?;
            protocol.path = Some(PathFile::new(file)?);
        }
        self.place_cameras(&mut protocol)?;
        protocol.samples = self.samples.unwrap_or(protocol.samples);
        protocol.runs = self.runs.unwrap_or(protocol.runs);
        if self.decompose {
            if self.runs.is_some_and(|runs| runs < DECOMPOSING_RUNS) {
                return Err(format!(
                    "--decompose takes at least {DECOMPOSING_RUNS} runs: leave --runs out, or raise it"
                ));
            }
            protocol.decompose = true;
            protocol.runs = protocol.runs.max(DECOMPOSING_RUNS);
        }
        Ok(protocol)
    }

    /// Makes each camera a view.
    fn place_cameras(&self, protocol: &mut Protocol) -> Result<(), String> {
        let count = self.camera.len() as u32;
        if count == 0 {
            return Ok(());
        }
        if self.views.is_some_and(|views| views < count) {
            return Err(format!(
                "{count} cameras are {count} views at least: leave --views out, or raise it"
            ));
        }
        if self.views.is_none() {
            protocol.views = count;
        }
        protocol.still_views = protocol.still_views.min(protocol.views);
        protocol.cameras = self.camera.iter().map(CameraPlace::to_string).collect();
        Ok(())
    }

    /// The techniques, in the order of tables. Those with other settings of the denoiser come last.
    fn names(&self) -> Result<Vec<&str>, String> {
        if self.techniques.is_empty() && self.held_out {
            return Ok(HELD_OUT_TECHNIQUES.into());
        }
        if self.techniques.is_empty() {
            return Ok(job::techniques(self.quick));
        }
        let mut asked: Vec<&str> = Vec::new();
        for name in self.techniques.iter().map(|name| name.trim()) {
            if !asked.contains(&name) {
                asked.push(name);
            }
        }
        if let Some(unknown) = asked.iter().find(|name| !techniques::is_known(name)) {
            return Err(format!(
                "there is no technique `{unknown}`; there are: {}",
                TECHNIQUES.join(", ")
            ));
        }
        let listed = TECHNIQUES.into_iter().filter(|name| asked.contains(name));
        let others = asked.iter().copied().filter(|name| !TECHNIQUES.contains(name));
        Ok(listed.chain(others).collect())
    }

    fn scenes(&self) -> Result<Vec<SceneSource>, String> {
        let mut scenes: Vec<SceneSource> = Vec::new();
        let built_in = self
            .scene
            .iter()
            .map(|name| SceneSource::BuiltIn(name.trim().replace('-', "_")));
        scenes.extend(built_in);
        for file in &self.gltf {
            let file = file
                .canonicalize()
                .map_err(|error| format!("{} can't be opened: {error}", file.display()))?;
            scenes.push(SceneSource::File(file));
        }
        if scenes.is_empty() {
            let names = if self.held_out {
                &SceneName::HELD_OUT.map(SceneName::as_str)[..]
            } else {
                &SCENES
            };
            scenes.extend(names.iter().map(|name| SceneSource::BuiltIn((*name).to_owned())));
        }
        let mut names: Vec<String> = scenes.iter().map(SceneSource::name).collect();
        names.sort();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(format!("two scenes have the name `{}`", pair[0]));
        }
        Ok(scenes)
    }

    fn tracers(&self, machine: &Machine) -> Result<Vec<TracerName>, String> {
        match (self.tracer, machine.ray_query) {
            (TracerWord::RayQuery, false) => Err(format!("{} has no ray queries that can be used", machine.adapter)),
            // A CPU follows rays through the BVH faster than by its ray queries.
            (TracerWord::Auto, true) if self.quick && machine.is_cpu => Ok(vec![TracerName::Bvh]),
            (TracerWord::Auto | TracerWord::RayQuery, true) => Ok(vec![TracerName::RayQuery]),
            (TracerWord::All, true) => Ok(vec![TracerName::RayQuery, TracerName::Bvh]),
            (TracerWord::Bvh, _) | (TracerWord::Auto | TracerWord::All, false) => Ok(vec![TracerName::Bvh]),
        }
    }

    /// True for compute, and for hardware, if they are measured.
    fn backends(&self, machine: &Machine) -> Result<(bool, bool), String> {
        match self.backend {
            BackendWord::Compute => Ok((true, false)),
            BackendWord::Auto => Ok((true, machine.hardware_vrs)),
            BackendWord::Hardware if machine.hardware_vrs => Ok((false, true)),
            BackendWord::Hardware => Err(format!("{} can't spread rays by its shading rate", machine.adapter)),
        }
    }
}

#[cfg(test)]
mod tests;
