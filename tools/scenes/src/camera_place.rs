//! A place of the camera on a command line.

use bevy::{math::Vec3, transform::components::Transform};
use std::{fmt, str::FromStr};

/// Place of a camera, and its target: `X,Y,Z,TX,TY,TZ` in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPlace {
    eye: Vec3,
    target: Vec3,
}

impl FromStr for CameraPlace {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        let numbers: Vec<f32> = word.split(',').map_while(|number| number.trim().parse().ok()).collect();
        match numbers[..] {
            [x, y, z, tx, ty, tz]
                if word.split(',').count() == 6 && numbers.iter().all(|number| number.is_finite()) =>
            {
                let (eye, target) = (Vec3::new(x, y, z), Vec3::new(tx, ty, tz));
                if eye == target {
                    return Err("the camera is at its target".into());
                }
                Ok(Self { eye, target })
            }
            _ => Err("expected six numbers: X,Y,Z,TX,TY,TZ".into()),
        }
    }
}

impl fmt::Display for CameraPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (eye, target) = (self.eye, self.target);
        write!(
            f,
            "{},{},{},{},{},{}",
            eye.x, eye.y, eye.z, target.x, target.y, target.z
        )
    }
}

impl CameraPlace {
    /// Its pose.
    pub fn transform(self) -> Transform {
        let up = if (self.target - self.eye).normalize().y.abs() > 0.999 {
            Vec3::Z
        } else {
            Vec3::Y
        };
        Transform::from_translation(self.eye).looking_at(self.target, up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_six_numbers() {
        let place: CameraPlace = "1, 2,3,-1,2,0.5".parse().unwrap();
        assert_eq!(place.to_string().parse(), Ok(place));
        assert!(place.transform().forward().dot(Vec3::new(-2.0, 0.0, -2.5).normalize()) > 0.999);
        let down: CameraPlace = "0,5,0,0,0,0".parse().unwrap();
        assert!(down.transform().is_finite() && down.transform().forward().y < -0.999);
        for (word, reason) in [
            ("", "six numbers"),
            ("1,2,3", "six numbers"),
            ("1,2,3,4,5,six", "six numbers"),
            ("1,2,3,4,5,inf", "six numbers"),
            ("1,2,3,1,2,3", "is at its target"),
        ] {
            let error = word.parse::<CameraPlace>().unwrap_err();
            assert!(error.contains(reason), "{word}: {error}");
        }
    }
}
