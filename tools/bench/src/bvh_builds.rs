//! Times of building the crate's own BVH on the CPU.

use crate::table::{Csv, Table, mebibytes, number, quantile};
use bevy::{
    ecs::world::World,
    math::{Affine3A, Quat, Vec3},
    mesh::Mesh,
    prelude::{Assets, GlobalTransform, Mesh3d, Transform},
};
use bevy_glint::internals::{
    bvh::{
        Blas, BvhQuality, Counters, LinearBuilder, LinearEntries, LinearEntry, SceneView, Tlas, TlasInstance, TraceRay,
        build_blas, build_tlas_of, closest, opening_budget, owner,
    },
    geometry::pack_mesh,
};
use glint_scenes::{SceneName, SceneOptions, spawn_with};
use std::{f32::consts::TAU, hint::black_box, time::Instant};

const QUALITIES: [(&str, BvhQuality); 3] = [
    ("fast", BvhQuality::Fast),
    ("medium", BvhQuality::Medium),
    ("high", BvhQuality::High),
];
const INSTANCE_COUNTS: [usize; 3] = [1_000, 10_000, 100_000];
/// A TLAS build is short: the median of this number is reported.
const TLAS_REPEATS: usize = 5;
/// Rays with counted visits.
const RAYS: u32 = 4_000;

/// A triangle list.
#[derive(Default)]
struct Soup {
    positions: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

/// Builds, measures and prints. `triangles` is the size of the generated mesh.
pub fn measure(triangles: u32, csv: &mut Csv) -> Result<(), String> {
    measure_blas_builds(triangles, csv)?;
    measure_tlas_builds(csv)
}

fn measure_blas_builds(triangles: u32, csv: &mut Csv) -> Result<(), String> {
    let mut blas_table = Table::new(
        "BLAS building (CPU, one build)",
        "mesh | triangles | quality | ms | MiB | B/triangle | stack",
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
    Ok(())
}

fn measure_tlas_builds(csv: &mut Csv) -> Result<(), String> {
    let tile = waves(512);
    let blas = build_blas(&tile.positions, &tile.indices, BvhQuality::default());
    let blas = blas.ok_or("no BLAS could be built for the instanced mesh")?;
    let title = format!("TLAS building (CPU, median of {TLAS_REPEATS}), and nodes that a ray visits");
    let columns = "builder | instances | entries | nodes | ms | MiB | stack | nodes/ray";
    let mut tlas_table = Table::new(title, columns);
    for count in INSTANCE_COUNTS {
        let instances = scattered(count, &blas);
        let mut linear = LinearBuilder::default();
        let mut builders: [(&str, &mut dyn FnMut() -> Tlas); 3] = [
            ("fast", &mut || {
                build_tlas_of(BvhQuality::Fast, &instances, opening_budget(count))
            }),
            ("medium", &mut || {
                build_tlas_of(BvhQuality::Medium, &instances, opening_budget(count))
            }),
            ("linear", &mut || linear.build(&mut entries(&instances)).clone()),
        ];
        for (word, build) in &mut builders {
            let mut times = Vec::new();
            let mut last = None;
            for _ in 0..TLAS_REPEATS {
                let begin = Instant::now();
                last = Some(black_box(build()));
                times.push(begin.elapsed().as_secs_f64() * 1e3);
            }
            let (Some(tlas), Some(milliseconds)) = (last, quantile(&times, 0.5)) else {
                continue;
            };
            let bytes = size_of_val(tlas.items.as_slice()) as u64;
            let visited = nodes_of_a_ray(&tlas, &blas, count);
            tlas_table.row([
                (*word).to_owned(),
                count.to_string(),
                tlas.entry_count.to_string(),
                tlas.node_count.to_string(),
                number(Some(milliseconds), 3),
                number(Some(mebibytes(bytes)), 2),
                tlas.stack.to_string(),
                number(Some(visited), 1),
            ]);
            let subject = format!("{count} instances");
            csv.add(&subject, word, "tlas_build", milliseconds, "ms");
            csv.add(&subject, word, "tlas_bytes", bytes as f64, "B");
            csv.add(&subject, word, "tlas_nodes_of_a_ray", visited, "");
        }
    }
    tlas_table.print();
    Ok(())
}

fn entries(instances: &[TlasInstance]) -> LinearEntries {
    let mut entries = LinearEntries::default();
    instances
        .iter()
        .filter_map(LinearEntry::new)
        .for_each(|entry| entries.push(entry));
    entries
}

/// Nodes of both levels that rays visit on average, from places within the scene in all directions.
fn nodes_of_a_ray(tlas: &Tlas, blas: &Blas, count: usize) -> f64 {
    let mut bvh = blas.items.clone();
    bvh.extend(&tlas.items);
    let view = SceneView {
        bvh: &bvh,
        tlas_node_count: tlas.traversal_node_count(),
        tlas_root: blas.items.len() as u32,
        alpha_test: None,
        order: None,
    };
    let mut counters = Counters::default();
    for ray in 0..RAYS {
        let height = 2.0 * along(ray, 0.754_877_7) - 1.0;
        let angle = along(ray, 0.569_840_3) * TAU;
        let flat = (1.0 - height * height).sqrt();
        let ray = TraceRay {
            origin: place(ray) * (count as f32).cbrt(),
            direction: Vec3::new(flat * angle.cos(), height, flat * angle.sin()),
            t_min: 0.0,
            t_max: f32::INFINITY,
        };
        black_box(closest(&view, &ray, &mut counters));
    }
    counters.nodes as f64 / f64::from(RAYS)
}

/// A number from 0 to 1 by the index in a sequence.
fn along(index: u32, step: f64) -> f32 {
    (f64::from(index) * step).fract() as f32
}

/// A place in the unit cube, by the R3 sequence, which fills it without lumps.
fn place(index: u32) -> Vec3 {
    Vec3::from([0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step| along(index, step)))
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

/// A square of a wavy surface with about this number of triangles.
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
            let rotation = Quat::from_rotation_y(along(instance, 0.618_034) * TAU);
            TlasInstance {
                world_from_object: Affine3A::from_rotation_translation(rotation, place(instance) * spread),
                bounds: blas.bounds,
                instance: owner(instance, 0),
                first_node: 0,
                first_triangle: blas.node_count,
                top: &blas.top,
                groups: blas.groups,
            }
        })
        .collect()
}
