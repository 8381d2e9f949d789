//! How much is measured.

use serde::{Deserialize, Serialize};
use std::{
    fs,
    path::{self, Path, PathBuf},
};

/// Frames after a camera cut before the error is measured.
pub const RECOVERY_FRAMES: [u32; 3] = [1, 4, 16];
/// Frames before a camera cut, so that there is a history to be thrown away.
pub const LEAD_FRAMES: u32 = 4;
/// Frames without a technique before the first one of a motion.
pub const CLEAR_FRAMES: u32 = 2;
/// Frames with recorded floating-point values.
pub const FLOAT_FRAMES: u32 = 2;
/// Static frames after which reflected light is measured.
pub const STATIC_FRAMES: u32 = 64;
/// Frames of a view's images that all techniques share, besides the ground truth: without any reflection, in a white environment, without
/// the light of reflections, and in fog.
pub const SHARED_FRAMES: u32 = 4 * LEAD_FRAMES;

/// Minimum number of runs to separate noise from bias.
pub const DECOMPOSING_RUNS: u32 = 4;

/// How much is measured. Everything that changes a result is in here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Protocol {
    /// Width of the image in pixels.
    pub width: u32,
    /// Height of the image in pixels.
    pub height: u32,
    /// Timed frames of each technique, rounded up to whole blocks.
    pub timing_frames: u32,
    /// Consecutive timed frames of one technique.
    pub block: u32,
    /// Frames after a switch of techniques that aren't.
    pub discard: u32,
    /// Views to compare.
    pub views: u32,
    /// Views in which static images are taken, too: recovery and flicker.
    pub still_views: u32,
    /// Runs in each view, which differ only in their noise. They give the uncertainty of the bias of reflected light.
    pub runs: u32,
    /// Frames of motion before an image is taken.
    pub motion_frames: u32,
    /// Static frames between which flicker is measured.
    pub flicker_frames: u32,
    /// Samples per pixel of the ground truth.
    pub samples: u32,
    /// Fineness of scenes built from code.
    pub detail: f32,
    /// Edge of their textures in texels.
    pub texture_size: u32,
    /// Edge of the shadow maps of directional lights in texels, a power of two. Shadow maps of point lights have half of it.
    pub shadow_size: u32,
    /// Maximum number of a directional light's shadow maps.
    pub cascades: u32,
    /// Places of the camera, `X,Y,Z,TX,TY,TZ`, in place of the scene's path.
    #[serde(default)]
    pub cameras: Vec<String>,
    /// A recorded path of the camera, in place of the scene's.
    #[serde(default)]
    pub path: Option<PathFile>,
    /// Splits the error of reflected light into noise and bias.
    #[serde(default)]
    pub decompose: bool,
    /// A folder of shader modules that replace the crate's for techniques. The ground truth keeps the crate's.
    #[serde(default)]
    pub shaders: Option<PathBuf>,
}

/// A file with a recorded path, and a hash of its content.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathFile {
    /// The file.
    pub file: PathBuf,
    /// Its hash: results of another path can't be mixed with these.
    pub hash: String,
}

impl PathFile {
    /// A file that can be read.
    pub fn new(file: &Path) -> Result<Self, String> {
        let fail = |error: std::io::Error| format!("{} can't be read: {error}", file.display());
        Ok(Self {
            file: path::absolute(file).map_err(fail)?,
            hash: blake3::hash(&fs::read(file).map_err(fail)?).to_string(),
        })
    }
}

impl Protocol {
    /// The protocol of a thorough run, or of a quick one; on a CPU everything is smaller.
    pub fn new(quick: bool, is_cpu: bool) -> Self {
        let full = Self {
            width: 1920,
            height: 1080,
            timing_frames: 5000,
            block: 50,
            discard: 8,
            views: 5,
            still_views: 5,
            runs: 4,
            motion_frames: 32,
            flicker_frames: 8,
            samples: 1024,
            detail: 1.0,
            texture_size: 1024,
            // The engine's and the scenes' own.
            shadow_size: 2048,
            cascades: 4,
            cameras: Vec::new(),
            path: None,
            decompose: false,
            shaders: None,
        };
        match (quick, is_cpu) {
            (false, false) => full,
            (false, true) => Self {
                width: 480,
                height: 270,
                timing_frames: 200,
                block: 20,
                discard: 4,
                still_views: 2,
                views: 3,
                runs: 2,
                samples: 512,
                texture_size: 256,
                ..full
            },
            (true, false) => Self {
                width: 960,
                height: 540,
                timing_frames: 120,
                block: 15,
                discard: 4,
                views: 2,
                still_views: 1,
                runs: 2,
                motion_frames: 16,
                flicker_frames: 4,
                samples: 192,
                texture_size: 512,
                ..full
            },
            // A frame of these scenes takes a CPU long, mostly for triangles and shadows: few frames of coarse scenes. Their times only
            // show that timing works.
            (true, true) => Self {
                width: 128,
                height: 72,
                timing_frames: 3,
                block: 1,
                discard: 4,
                views: 1,
                still_views: 0,
                runs: 1,
                motion_frames: 6,
                flicker_frames: 2,
                samples: 24,
                detail: 0.25,
                texture_size: 64,
                shadow_size: 512,
                cascades: 1,
                ..full
            },
        }
    }

    /// Rounds in which all techniques take turns.
    pub fn rounds(&self) -> u32 {
        self.timing_frames.div_ceil(self.block.max(1)).max(1)
    }

    /// Views that are searched for broken pixels.
    pub fn float_views(&self) -> u32 {
        self.still_views.max(1).min(self.views)
    }

    /// Frames for the images of one technique.
    pub fn image_frames(&self) -> u64 {
        let [.., last] = RECOVERY_FRAMES;
        let motion = self.runs.max(1) * (CLEAR_FRAMES + self.motion_frames);
        let first = STATIC_FRAMES.max(last + self.flicker_frames);
        let still = LEAD_FRAMES + first + (self.runs.max(1) - 1) * STATIC_FRAMES;
        u64::from(self.views) * u64::from(motion)
            + u64::from(self.still_views.min(self.views)) * u64::from(still)
            + u64::from(self.float_views()) * u64::from(FLOAT_FRAMES)
    }

    /// Frames of one turn of one technique in one round.
    pub fn turn_frames(&self) -> u64 {
        // Measurements arrive a frame late.
        u64::from(self.discard + self.block + 1)
    }

    /// Frames of one view's ground truth.
    pub fn truth_frames(&self) -> u64 {
        u64::from(LEAD_FRAMES + self.samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protocols_can_decide() {
        for (quick, is_cpu) in [(false, false), (false, true), (true, false), (true, true)] {
            let protocol = Protocol::new(quick, is_cpu);
            // With fewer rounds the interval of a ratio means little. A quick run on a CPU decides nothing anyway.
            let rounds = if quick && is_cpu { 3 } else { 5 };
            assert!(protocol.rounds() >= rounds, "{protocol:?}");
            assert!(protocol.flicker_frames >= 2 && protocol.views >= 1 && protocol.float_views() >= 1);
            assert!(protocol.still_views <= protocol.views && protocol.shadow_size.is_power_of_two());
        }
    }

    #[test]
    fn images_take_the_frames_that_they_need() {
        let protocol = Protocol {
            views: 3,
            still_views: 0,
            runs: 1,
            motion_frames: 10,
            ..Protocol::new(true, true)
        };
        // Motion in each view, and one look at floating-point values.
        assert_eq!(protocol.image_frames(), 3 * (2 + 10) + 2);
        let still = Protocol {
            still_views: 2,
            flicker_frames: 5,
            ..protocol
        };
        assert_eq!(still.image_frames(), 3 * (2 + 10) + 2 * (4 + 64 + 2));
        let twice = Protocol { runs: 2, ..still };
        assert_eq!(twice.image_frames(), 2 * 3 * (2 + 10) + 2 * (4 + 64 + 64 + 2));
    }
}
