//! Times of building the crate's own BVH on the CPU.

use crate::table::{Csv, Table, mebibytes, number, quantile};
use bevy::{
    ecs::world::World,
    math::{Affine3A, Quat, Vec3},
    mesh::Mesh,
    prelude::{Assets, GlobalTransform, Mesh3d, Transform},
};
use bevy_glint::scene::{
    bvh::{Blas, BvhQuality, TlasInstance, build_blas, build_tlas, opening_budget},
    geometry::pack_mesh,
};
use glint_scenes::{SceneName, SceneOptions, spawn_with};
use std::{hint::black_box, time::Instant};

const QUALITIES: [(&str, BvhQuality); 3] = [
    ("fast", BvhQuality::Fast),
    ("medium", BvhQuality::Medium),
    ("high", BvhQuality::High),
];
const INSTANCE_COUNTS: [usize; 3] = [1_000, 10_000, 100_000];
/// A TLAS build is short: the median of so many is reported.
const TLAS_REPEATS: usize = 5;

/// A triangle list.
#[derive(Default)]
struct Soup {
    positions: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

/// Builds, measures and prints. `triangles` is the size of the generated mesh.
pub fn measure(triangles: u32, csv: &mut Csv) -> Result<(), String> {
    let mut blas_table = Table::new(
        "BLAS building (CPU, one build)",
        &["mesh", "triangles", "quality", "ms", "MiB", "B/triangle", "stack"],
    );
    for (name, soup) in [
        ("atrium_small_merged", merged(SceneName::AtriumSmall)),
        ("atrium_merged", merged(SceneName::Atrium)),
        ("generated", waves(triangles)),
    ] {
        for (word, quality) in QUALITIES {
            let begin = Instant::now();
            let blas = build_blas(&soup.positions, &soup.indices, quality);
            let milliseconds = begin.elapsed().as_secs_f64() * 1e3;
            let blas = blas.ok_or_else(|| format!("no BLAS could be built for the mesh '{name}'"))?;
            let bytes = blas.bytes() as u64;
            let per_triangle = bytes as f64 / f64::from(blas.triangle_count);
            blas_table.row([
                name.to_owned(),
                blas.triangle_count.to_string(),
                word.to_owned(),
                number(Some(milliseconds), 2),
                number(Some(mebibytes(bytes)), 2),
                number(Some(per_triangle), 1),
                blas.groups.to_string(),
            ]);
            csv.add(name, word, "blas_triangles", f64::from(blas.triangle_count), "");
            csv.add(name, word, "blas_build", milliseconds, "ms");
            csv.add(name, word, "blas_bytes", bytes as f64, "B");
        }
    }
    blas_table.print();

    let tile = waves(512);
    let blas = build_blas(&tile.positions, &tile.indices, BvhQuality::default());
    let blas = blas.ok_or("no BLAS could be built for the instanced mesh")?;
    let title = format!("TLAS building (CPU, median of {TLAS_REPEATS})");
    let mut tlas_table = Table::new(title, &["instances", "entries", "nodes", "ms", "MiB", "stack"]);
    for count in INSTANCE_COUNTS {
        let instances = scattered(count, &blas);
        let mut times = Vec::new();
        let mut last = None;
        for _ in 0..TLAS_REPEATS {
            let begin = Instant::now();
            let tlas = build_tlas(black_box(&instances), opening_budget(count));
            times.push(begin.elapsed().as_secs_f64() * 1e3);
            last = Some(tlas);
        }
        let (Some(tlas), Some(milliseconds)) = (last, quantile(&times, 0.5)) else {
            continue;
        };
        let bytes = size_of_val(tlas.items.as_slice()) as u64;
        tlas_table.row([
            count.to_string(),
            tlas.entry_count.to_string(),
            tlas.node_count.to_string(),
            number(Some(milliseconds), 3),
            number(Some(mebibytes(bytes)), 2),
            tlas.groups.to_string(),
        ]);
        let subject = format!("instances_{count}");
        csv.add(&subject, "bvh", "tlas_build", milliseconds, "ms");
        csv.add(&subject, "bvh", "tlas_bytes", bytes as f64, "B");
    }
    tlas_table.print();
    Ok(())
}

/// All meshes of a scene in world space.
fn merged(scene: SceneName) -> Soup {
    let mut world = World::new();
    // Textures don't matter here.
    let options = SceneOptions {
        texture_size: 4,
        ..Default::default()
    };
    spawn_with(scene, &mut world, &options);
    let mut soup = Soup::default();
    let mut placed = world.query::<(&Mesh3d, &Transform)>();
    let meshes = world.resource::<Assets<Mesh>>();
    for (mesh, transform) in placed.iter(&world) {
        let Some(Ok(packed)) = meshes.get(&mesh.0).map(pack_mesh) else {
            continue;
        };
        let world_from_object = GlobalTransform::from(*transform).affine();
        let base = soup.positions.len() as u32;
        let positions = packed.positions().iter();
        soup.positions
            .extend(positions.map(|p| world_from_object.transform_point3(Vec3::from(*p)).to_array()));
        soup.indices.extend(packed.indices().iter().map(|index| base + index));
    }
    soup
}

/// A square of a wavy surface with about so many triangles.
fn waves(triangles: u32) -> Soup {
    let edge = f64::from(triangles.max(2) / 2).sqrt().round().max(1.0) as u32;
    let mut soup = Soup::default();
    for y in 0..=edge {
        for x in 0..=edge {
            let (u, v) = (x as f32 / edge as f32, y as f32 / edge as f32);
            let height = 0.05 * (19.0 * u).sin() * (23.0 * v).cos() + 0.01 * (131.0 * u + 97.0 * v).sin();
            soup.positions.push([u - 0.5, height, v - 0.5]);
        }
    }
    for y in 0..edge {
        for x in 0..edge {
            let a = y * (edge + 1) + x;
            let (b, c, d) = (a + 1, a + edge + 1, a + edge + 2);
            soup.indices.extend([a, c, b, b, c, d]);
        }
    }
    soup
}

/// Instances of one mesh, spread evenly over a cube.
fn scattered(count: usize, blas: &Blas) -> Vec<TlasInstance<'_>> {
    let spread = (count as f32).cbrt();
    (0..count as u32)
        .map(|instance| {
            // The R3 sequence fills the cube without lumps.
            let along = |step: f64| (f64::from(instance) * step).fract() as f32;
            let place = Vec3::new(along(0.819_172_5), along(0.671_043_6), along(0.549_700_5));
            let rotation = Quat::from_rotation_y(along(0.618_034) * core::f32::consts::TAU);
            TlasInstance {
                world_from_object: Affine3A::from_rotation_translation(rotation, place * spread),
                bounds: blas.bounds,
                instance,
                first_node: 0,
                first_triangle: blas.node_count,
                top: &blas.top,
                groups: blas.groups,
            }
        })
        .collect()
}
