//! A recorded path of the camera, and its text format.

use bevy::{
    math::{Quat, Vec3},
    transform::components::Transform,
};
use std::{fmt, fs, path::Path, str::FromStr};

const HEADER: &str =
    "# Camera path of bevy_glint. Each line: seconds, position (x y z, metres), rotation (quaternion, x y z w).";
/// Minimum number of seconds between two recorded poses: every other frame of 60 a second.
const INTERVAL: f32 = 0.03;
/// The latest time in seconds: beyond it, frames are too close for `f32`.
const MAX_SECONDS: f32 = 10_000.0;
/// Minimum length of a path in seconds: the 32 frames of motion before an image that is compared with the truth.
const MIN_LENGTH: f32 = 32.0 / 60.0;

/// Poses at increasing times. Seconds refer to the clock that moves the scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedPath {
    poses: Vec<(f32, Transform)>,
}

impl RecordedPath {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// If it can't be read, or contains no path; with its name and the reason, in one line.
    pub fn load(file: &Path) -> Result<Self, String> {
        let text = fs::read_to_string(file).map_err(|error| format!("{} can't be read: {error}", file.display()))?;
        text.parse()
            .map_err(|reason| format!("{} is no camera path: {reason}", file.display()))
    }

    /// Writes a file.
    ///
    /// # Errors
    ///
    /// If it can't be written, or if the path is too short to be read again.
    pub fn save(&self, file: &Path) -> Result<(), String> {
        let text = self.to_string();
        text.parse::<Self>()
            .map_err(|reason| format!("{} was not written: {reason}", file.display()))?;
        fs::write(file, text).map_err(|error| format!("{} can't be written: {error}", file.display()))
    }

    /// Adds the pose of the camera. Poses that follow too soon on the last one, or are not finite, are skipped.
    pub fn push(&mut self, seconds: f32, pose: &Transform) {
        let is_due = self.poses.last().is_none_or(|(last, _)| seconds - last >= INTERVAL);
        if is_due && seconds.is_finite() && pose.is_finite() {
            let pose = Transform::from_translation(pose.translation).with_rotation(pose.rotation);
            self.poses.push((seconds, pose));
        }
    }

    /// Time of the first pose; 0 without any.
    pub fn start(&self) -> f32 {
        self.poses.first().map_or(0.0, |(seconds, _)| *seconds)
    }

    /// Time of the last pose; 0 without any.
    pub fn end(&self) -> f32 {
        self.poses.last().map_or(0.0, |(seconds, _)| *seconds)
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// True without any pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The pose at a time, between its neighbours; it rests before the first one and after the last one.
    pub fn pose(&self, seconds: f32) -> Transform {
        let next = self.poses.partition_point(|(time, _)| *time <= seconds);
        let before = next.checked_sub(1).and_then(|index| self.poses.get(index));
        match (before, self.poses.get(next)) {
            (Some((from, a)), Some((to, b))) => {
                let share = (seconds - from) / (to - from);
                Transform::from_translation(a.translation.lerp(b.translation, share))
                    .with_rotation(a.rotation.slerp(b.rotation, share))
            }
            (Some((_, pose)), None) | (None, Some((_, pose))) => *pose,
            (None, None) => Transform::IDENTITY,
        }
    }
}

impl fmt::Display for RecordedPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{HEADER}")?;
        for (seconds, pose) in &self.poses {
            let (Vec3 { x, y, z }, rotation) = (pose.translation, pose.rotation);
            let [a, b, c, d] = rotation.to_array();
            writeln!(f, "{seconds} {x} {y} {z} {a} {b} {c} {d}")?;
        }
        Ok(())
    }
}

impl FromStr for RecordedPath {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut poses: Vec<(f32, Transform)> = Vec::new();
        for (number, line) in (1..).zip(text.lines()) {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let values: Option<Vec<f32>> = line
                .split_whitespace()
                .map(|word| word.parse().ok().filter(|value: &f32| value.is_finite()))
                .collect();
            let values = values.and_then(|values| <[f32; 8]>::try_from(values).ok());
            let [seconds, x, y, z, a, b, c, d] =
                values.ok_or_else(|| format!("line {number} doesn't hold eight finite numbers"))?;
            let rotation = Quat::from_xyzw(a, b, c, d);
            if !(0.9..1.1).contains(&rotation.length()) {
                return Err(format!("the rotation in line {number} is no unit quaternion"));
            }
            if seconds < 0.0 || poses.last().is_some_and(|(last, _)| seconds <= *last) {
                return Err(format!("the time in line {number} is not later than the one before it"));
            }
            if seconds > MAX_SECONDS {
                return Err(format!(
                    "the time in line {number} is above {MAX_SECONDS} seconds: record soon after the start"
                ));
            }
            let pose = Transform::from_xyz(x, y, z).with_rotation(rotation.normalize());
            poses.push((seconds, pose));
        }
        if poses.len() < 2 {
            return Err("it holds fewer than two poses".to_owned());
        }
        let path = Self { poses };
        let length = path.end() - path.start();
        if length < MIN_LENGTH {
            return Err(format!(
                "it lasts {length:.2} seconds, at least {MIN_LENGTH:.2} are needed: record for longer"
            ));
        }
        Ok(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorded() -> RecordedPath {
        let mut path = RecordedPath::default();
        for frame in 0..60 {
            let seconds = 3.7 + frame as f32 / 60.0;
            let eye = Vec3::new(0.1 * frame as f32, 1.6, -2.0 / 3.0);
            path.push(
                seconds,
                &Transform::from_translation(eye).looking_at(Vec3::new(9.0, 1.0, 4.0), Vec3::Y),
            );
        }
        path
    }

    #[test]
    fn a_path_survives_its_file() {
        let path = recorded();
        assert!((25..=31).contains(&path.len()), "{} poses of a second", path.len());
        let folder = std::env::temp_dir().join(format!("glint_path_{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let file = folder.join("path.txt");
        path.save(&file).unwrap();
        let read = RecordedPath::load(&file).unwrap();
        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(
            (read.start(), read.end(), read.len()),
            (path.start(), path.end(), path.len())
        );
        for step in 0..=100 {
            let seconds = 3.6 + 0.012 * step as f32;
            let (a, b) = (path.pose(seconds), read.pose(seconds));
            assert!(a.translation.distance(b.translation) < 1e-6 && a.rotation.abs_diff_eq(b.rotation, 1e-5));
        }
    }

    #[test]
    fn poses_lie_between_their_neighbours() {
        let path: RecordedPath = "1 0 0 0 0 0 0 1\n\n# a comment\n3 4 0 0 0 1 0 0\n".parse().unwrap();
        assert_eq!(path.pose(2.0).translation, Vec3::new(2.0, 0.0, 0.0));
        let turned = path.pose(2.0).rotation.angle_between(Quat::IDENTITY);
        assert!((turned - std::f32::consts::FRAC_PI_2).abs() < 1e-3, "{turned}");
        assert_eq!((path.pose(-5.0), path.pose(9.0)), (path.pose(1.0), path.pose(3.0)));
    }

    #[test]
    fn bad_files_are_declined_in_one_line() {
        for (text, reason) in [
            ("", "fewer than two poses"),
            ("0 0 0 0 0 0 0 1", "fewer than two poses"),
            ("0 0 0 0 0 0 0 1\n1 2 3", "line 2"),
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 one", "line 2"),
            ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1 9", "line 2"),
            ("0 0 NaN 0 0 0 0 1\n1 0 0 0 0 0 0 1", "line 1"),
            ("0 0 0 0 0 0 0 0\n1 0 0 0 0 0 0 1", "no unit quaternion"),
            ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1", "not later"),
            ("-1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1", "not later"),
            ("0 0 0 0 0 0 0 1\n1e30 0 0 0 0 0 0 1", "line 2 is above 10000"),
            ("9 0 0 0 0 0 0 1\n9.5 0 0 0 0 0 0 1", "0.50 seconds"),
        ] {
            let error = text.parse::<RecordedPath>().unwrap_err();
            assert!(
                error.contains(reason) && error.lines().count() == 1,
                "{text:?}: {error}"
            );
        }
        let error = RecordedPath::load(Path::new("/no/such/path.txt")).unwrap_err();
        assert!(
            error.contains("/no/such/path.txt can't be read") && error.lines().count() == 1,
            "{error}"
        );
        let nothing = RecordedPath::default()
            .save(Path::new("/no/such/path.txt"))
            .unwrap_err();
        assert!(nothing.contains("fewer than two poses"), "{nothing}");
    }

    #[test]
    fn what_is_not_finite_is_not_recorded() {
        let mut path = recorded();
        let before = path.len();
        path.push(f32::NAN, &Transform::IDENTITY);
        path.push(99.0, &Transform::from_xyz(f32::INFINITY, 0.0, 0.0));
        assert_eq!(path.len(), before);
    }
}
