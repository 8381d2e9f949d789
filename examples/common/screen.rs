//! Cameras that share a screen side by side.

use bevy::{camera::Viewport, prelude::*};

/// The part of the screen that a camera draws: one of `count` columns of the same width, counted from the left.
#[derive(Component, Clone, Copy, Debug)]
pub struct Column {
    pub index: u32,
    pub count: u32,
}

/// Keeps viewports at their columns, whatever the size of the window or picture.
pub fn fit_columns(mut cameras: Query<(&mut Camera, &Column)>) {
    for (mut camera, column) in &mut cameras {
        // Unknown before the first frame.
        let Some(size) = camera.physical_target_size() else {
            continue;
        };
        let edge = |index: u32| size.x * index / column.count.max(1);
        let (left, right) = (edge(column.index), edge(column.index + 1));
        let position = UVec2::new(left, 0);
        let extent = UVec2::new(right - left, size.y).max(UVec2::ONE);
        let present = camera
            .viewport
            .as_ref()
            .map(|viewport| (viewport.physical_position, viewport.physical_size));
        if present != Some((position, extent)) {
            camera.viewport = Some(Viewport {
                physical_position: position,
                physical_size: extent,
                ..default()
            });
        }
    }
}
