//! The plots along the streets and the house on each of them.

use super::plan::*;
use crate::prelude::*;

/// Roof of a house.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Roof {
    /// A steep roof of clay tiles.
    Tiles,
    /// A mansard of slates with dormers.
    Slates,
    /// A flat roof behind a parapet.
    Parapet,
}

/// The end of a plot at a street corner.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Corner {
    /// Neither.
    None,
    /// The left end.
    Left,
    /// The right end.
    Right,
    /// None: this is the second front of the house on the corner.
    SecondFront,
}

/// A house of a row.
#[derive(Clone, Copy)]
pub struct Plot {
    /// Width of the front.
    pub width: f32,
    /// Depth of the house.
    pub depth: f32,
    /// Its roof.
    pub roof: Roof,
    /// Number of floors.
    pub storeys: u32,
    /// Index of the material of its walls.
    pub wall: usize,
    /// The street corner that it occupies, if any.
    pub corner: Corner,
    /// One letter for each bay of the ground floor: shop, entrance of a shop, door, or window. Capitals are the café's.
    ground: &'static str,
}

const fn plot(width: f32, storeys: u32, wall: usize, roof: Roof, ground: &'static str) -> Plot {
    Plot {
        width,
        depth: 9.0,
        roof,
        storeys,
        wall,
        corner: Corner::None,
        ground,
    }
}

impl Plot {
    const fn on_corner(self, corner: Corner, depth: f32) -> Self {
        Self { depth, corner, ..self }
    }

    /// The letter of a bay of the ground floor.
    pub fn letter(&self, bay: u32) -> u8 {
        self.ground.as_bytes().get(bay as usize).copied().unwrap_or(b'w')
    }

    /// Bays of the front.
    pub fn bays(&self) -> u32 {
        self.ground.len() as u32
    }

    /// Width of a bay.
    pub fn bay(&self) -> f32 {
        self.width / self.bays() as f32
    }

    /// Middle of a bay.
    pub fn middle(&self, bay: u32) -> f32 {
        (bay as f32 + 0.5) * self.bay()
    }

    /// Height of the walls.
    pub fn height(&self) -> f32 {
        GROUND_STOREY + STOREY * (self.storeys - 1) as f32 + 0.35
    }
}

/// Houses side by side, from left to right as seen from the street.
pub struct Row {
    /// Left end of the first front, at the height of the pavement.
    pub origin: Vec3,
    /// Turn of the fronts, which face +z, about the y axis.
    pub degrees: f32,
    /// Its houses.
    pub plots: &'static [Plot],
}

const fn row(x: f32, z: f32, degrees: f32, plots: &'static [Plot]) -> Row {
    Row {
        origin: vec3(x, PAVEMENT, z),
        degrees,
        plots,
    }
}

/// The northern side, up to the café on the corner.
const NORTH_WEST: &[Plot] = &[
    plot(9.0, 4, 0, Roof::Tiles, "swd"),
    plot(8.0, 3, 5, Roof::Tiles, "wdw"),
    plot(9.5, 5, 2, Roof::Slates, "sesd"),
    plot(8.5, 4, 1, Roof::Tiles, "wds"),
    plot(13.0, 4, 7, Roof::Parapet, "SSESS").on_corner(Corner::Right, 10.4),
];
/// The northern side from the other corner.
const NORTH_EAST: &[Plot] = &[
    plot(10.0, 4, 8, Roof::Parapet, "sesd").on_corner(Corner::Left, 12.0),
    plot(9.0, 3, 3, Roof::Parapet, "wdw"),
    plot(10.0, 5, 6, Roof::Slates, "sdsw"),
];
/// The southern side, from the east.
const SOUTH_SIDE: &[Plot] = &[
    plot(10.0, 4, 4, Roof::Tiles, "wdsw"),
    plot(9.0, 5, 7, Roof::Slates, "sds"),
    plot(8.0, 3, 1, Roof::Tiles, "wdw"),
    plot(11.0, 4, 0, Roof::Tiles, "wsew"),
    plot(9.0, 5, 8, Roof::Slates, "sed"),
    plot(10.0, 3, 2, Roof::Tiles, "wdws"),
    plot(8.5, 4, 5, Roof::Slates, "ses"),
    plot(11.0, 4, 3, Roof::Tiles, "wdww"),
    plot(9.5, 5, 6, Roof::Slates, "sdes"),
];
/// The western side of the side street, from the café.
const SIDE_LEFT: &[Plot] = &[
    plot(10.4, 4, 7, Roof::Parapet, "SSwd").on_corner(Corner::SecondFront, 0.0),
    plot(9.0, 3, 4, Roof::Tiles, "wdw"),
    plot(12.6, 4, 2, Roof::Slates, "wdwsw"),
];
/// The eastern side of the side street, towards the corner.
const SIDE_RIGHT: &[Plot] = &[
    plot(9.0, 4, 1, Roof::Tiles, "wdw"),
    plot(11.0, 3, 5, Roof::Tiles, "wdww"),
    plot(12.0, 4, 8, Roof::Parapet, "dwses").on_corner(Corner::SecondFront, 0.0),
];
/// The end of the side street.
const NORTH_CLOSE: &[Plot] = &[plot(9.0, 4, 0, Roof::Slates, "wdw")];
/// The eastern end of the street.
const EAST_CLOSE: &[Plot] = &[plot(7.5, 4, 2, Roof::Tiles, "wdw"), plot(7.5, 3, 5, Roof::Tiles, "sds")];
/// The western end of the street.
const WEST_CLOSE: &[Plot] = &[
    plot(7.5, 4, 3, Roof::Slates, "wdw"),
    plot(7.5, 4, 1, Roof::Tiles, "wds"),
];

/// All rows.
pub const ROWS: [Row; 8] = [
    row(WEST, NORTH, 0.0, NORTH_WEST),
    row(SIDE_EAST, NORTH, 0.0, NORTH_EAST),
    row(EAST, SOUTH, 180.0, SOUTH_SIDE),
    row(SIDE_WEST, NORTH, 90.0, SIDE_LEFT),
    row(SIDE_EAST, SIDE_END, -90.0, SIDE_RIGHT),
    row(SIDE_WEST, SIDE_END, 0.0, NORTH_CLOSE),
    row(EAST, NORTH, -90.0, EAST_CLOSE),
    row(WEST, SOUTH, 90.0, WEST_CLOSE),
];
