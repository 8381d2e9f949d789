//! Compares vertices and trees that the GPU poses with CPU versions.

use super::{
    bounds::{enlarged, posed_bounds},
    extract::Rows,
    job::{Batch, PoseJob},
    kernels::{Kernels, PosePass, RefitKernels, level_layout, pose_layout, refit_layout},
    poses::posed_header,
    vertex_shader::{Inputs, Motion},
};
use crate::{
    scene::{
        acceleration::rows,
        bvh::{Blas, Bounds, BvhQuality, Item, build_posable_blas},
        geometry::{BASE_ALIGNMENT, HEADER_WORDS, PackedMesh, pack_mesh},
        motion::unpack_vector,
        test_gpu,
    },
    settings::ReflectedVertices,
};
use bevy::{
    asset::RenderAssetUsages,
    math::{Affine3A, DMat4, DVec3, Quat, Vec2, Vec3, Vec4},
    mesh::{Indices, Mesh, PrimitiveTopology, VertexAttributeValues, morph::MorphAttributes, octahedral_decode_signed},
    render::{
        render_resource::{
            BindGroupLayout, Buffer, BufferInitDescriptor, BufferUsages, ComputePipeline, PipelineCompilationOptions,
            RawComputePipelineDescriptor, ShaderModuleDescriptor, ShaderSource,
        },
        renderer::{RenderDevice, RenderQueue},
    },
};

/// Uses all that the app's shader gets.
const APP_VERTEX: &str = "
    import package::scene::pose::vertex::{app_uniform, VertexPoint, WorldVertex};

    fn reflected_vertex(vertex: WorldVertex, at: VertexPoint) -> WorldVertex {
        let sum = at.parameters.xyz * at.seconds + app_uniform(1u).xyz + app_uniform(2u).xyz
            + vec3(at.uv, f32(at.index)) + at.color.rgb + at.world_from_object[3].xyz;
        return WorldVertex(vertex.position + 0.01 * sum, vertex.normal.zxy);
    }
";

fn pipeline(
    device: &RenderDevice,
    main: &'static str,
    entry_point: &str,
    layouts: &[&BindGroupLayout],
    flags: &[&'static str],
) -> ComputePipeline {
    let modules = [
        ("common/numeric.wesl", include_str!("../../common/numeric.wesl")),
        ("common/octahedral.wesl", include_str!("../../common/octahedral.wesl")),
        (
            "common/packed_vector.wesl",
            include_str!("../../common/packed_vector.wesl"),
        ),
        ("scene/pose/job.wesl", include_str!("job.wesl")),
        ("scene/pose/vertex.wesl", include_str!("vertex.wesl")),
        ("scene/pose/app_vertex.wesl", APP_VERTEX),
        ("scene/types.wesl", include_str!("../types.wesl")),
    ];
    let module = device.create_and_validate_shader_module(ShaderModuleDescriptor {
        label: None,
        source: ShaderSource::Wgsl(test_gpu::link(main, &modules, flags).into()),
    });
    let layouts: Vec<Option<&wgpu::BindGroupLayout>> = layouts.iter().map(|layout| Some(&***layout)).collect();
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &layouts,
        immediate_size: 0,
    });
    device.create_compute_pipeline(&RawComputePipelineDescriptor {
        label: None,
        layout: Some(&layout),
        module: &module,
        entry_point: Some(entry_point),
        compilation_options: PipelineCompilationOptions::default(),
        cache: None,
    })
}

fn kernels(device: &RenderDevice) -> Kernels {
    let [pose_layout, layout, level_layout] = [pose_layout(), refit_layout(), level_layout()]
        .map(|descriptor| device.create_bind_group_layout(None, &descriptor.entries));
    let refit = |entry_point| {
        pipeline(
            device,
            include_str!("refit.wesl"),
            entry_point,
            &[&layout, &level_layout],
            &[],
        )
    };
    let pose = |flags: &[&'static str]| {
        pipeline(
            device,
            include_str!("pose.wesl"),
            "pose_vertices",
            &[&pose_layout],
            flags,
        )
    };
    Kernels {
        pose: pose(&[]),
        moving: Some(pose(&["VERTEX_SHADER"])),
        moving_version: 0,
        refit: Some(RefitKernels {
            triangles: refit("pose_triangles"),
            nodes: refit("fit_level"),
            layout: layout.clone(),
            level_layout: level_layout.clone(),
        }),
        pose_layout,
    }
}

/// A bumpy sheet with two joints along X, and a morph target.
fn sheet(columns: u32, rows: u32, has_skin: bool) -> Mesh {
    let at = |i: u32| Vec2::new((i % columns) as f32, (i / columns) as f32);
    let vertices = || (0..columns * rows).map(at);
    let height = |p: Vec2| 0.7 * (1.3 * p.x).sin() * (0.9 * p.y).cos();
    let mut indices = Vec::new();
    for y in 0..rows - 1 {
        for x in 0..columns - 1 {
            let [a, b] = [y * columns + x, (y + 1) * columns + x];
            indices.extend([a, a + 1, b, b, a + 1, b + 1]);
        }
    }
    let positions: Vec<[f32; 3]> = vertices().map(|p| [p.x, height(p), p.y]).collect();
    let normals = vertices().map(|p| Vec3::new(0.3 * p.x.sin(), 1.0, 0.2 * p.y.sin()).normalize().to_array());
    let tangents: Vec<[f32; 4]> = vertices()
        .map(|p| [1.0, 0.1 * p.y.cos(), 0.0, if p.x > 2.0 { -1.0 } else { 1.0 }])
        .collect();
    let morph = |p: Vec2| MorphAttributes::new(Vec3::new(p.y, -p.x, 1.0) * 0.2, Vec3::X, Vec3::Y * 0.5);
    let mut mesh = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals.collect::<Vec<_>>())
        .with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, tangents)
        .with_inserted_indices(Indices::U32(indices))
        .with_morph_targets(vertices().map(morph).collect());
    if has_skin {
        let share = |p: Vec2| p.x / (columns - 1) as f32;
        let weights: Vec<[f32; 4]> = vertices().map(|p| [1.0 - share(p), 0.0, share(p), 0.0]).collect();
        let joints = VertexAttributeValues::Uint16x4(vec![[0, 3, 1, 0]; weights.len()]);
        mesh.insert_attribute(Mesh::ATTRIBUTE_JOINT_INDEX, joints);
        mesh.insert_attribute(Mesh::ATTRIBUTE_JOINT_WEIGHT, weights);
    }
    mesh
}

/// Triangles that start a rounding error below multiples of the steps between planes.
fn comb() -> Mesh {
    let teeth = (1..=40u8).map(|tooth| (6.0 * f32::from(tooth)).next_down());
    let positions: Vec<[f32; 3]> = teeth
        .flat_map(|x| [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 1.0]])
        .collect();
    let unmoved = vec![MorphAttributes::default(); positions.len()];
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, vec![[0.0, 1.0, 0.0]; positions.len()])
        .with_inserted_attribute(Mesh::ATTRIBUTE_TANGENT, vec![[1.0, 0.0, 0.0, 1.0]; positions.len()])
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_morph_targets(unmoved)
}

/// The last place of a vertex.
fn before(vertex: usize) -> Vec3 {
    Vec3::new(0.5, -1.0, 2.0) + 0.25 * (vertex % 17) as f32
}

/// A posed mesh, and its position in both buffers.
struct Subject {
    packed: PackedMesh,
    blas: Blas,
    matrices: Vec<Affine3A>,
    weight: f32,
    job: PoseJob,
}

impl Subject {
    /// Appends the mesh, and space for the posed one.
    fn new(
        mesh: &Mesh,
        matrices: Vec<Affine3A>,
        weight: f32,
        (geometry, bvh): (&mut Vec<u32>, &mut Vec<Item>),
        batch: &mut Batch,
    ) -> Self {
        let packed = pack_mesh(mesh).unwrap();
        let blas = build_posable_blas(packed.positions(), packed.indices(), BvhQuality::Medium).unwrap();
        let rows: Vec<Rows> = matrices.iter().map(|matrix| bytemuck::cast(rows(matrix))).collect();
        let bounds = posed_bounds(packed.deformation.as_ref().unwrap(), &rows, &[weight]);
        let aligned = |words: &mut Vec<u32>| {
            words.resize(words.len().next_multiple_of(BASE_ALIGNMENT as usize), 0);
            words.len() as u32
        };
        let source = aligned(geometry);
        geometry.extend_from_slice(&packed.words);
        let posed = aligned(geometry);
        let counts = [packed.vertex_count, packed.triangle_count];
        geometry.extend(posed_header(posed, source, packed.offsets, counts));
        for vertex in 0..packed.vertex_count {
            geometry.extend(before(vertex as usize).to_array().map(f32::to_bits));
        }
        geometry.resize(geometry.len() + 3 * packed.vertex_count as usize, 0);
        let source_node = bvh.len() as u32;
        bvh.extend_from_slice(&blas.items);
        let posed_node = bvh.len() as u32;
        bvh.resize(bvh.len() + blas.items.len(), Item::default());
        let levels = blas.levels();
        let job = PoseJob {
            bounds_min: bounds.min,
            source,
            bounds_max: bounds.max,
            posed,
            matrices: batch.add(bytemuck::cast_slice(&rows)),
            joint_count: matrices.len() as u32,
            weights: batch.add(&[weight.to_bits()]),
            target_count: 1,
            source_node,
            posed_node,
            node_count: blas.node_count,
            triangle_count: blas.triangle_count,
            levels: batch.add(&levels),
            level_count: levels.len() as u32 - 1,
            boxes: batch.boxes,
            vertex_count: packed.vertex_count,
            ..PoseJob::default()
        };
        batch.boxes += blas.node_count;
        batch.jobs.push(job);
        Self {
            packed,
            blas,
            matrices,
            weight,
            job,
        }
    }

    /// Matrix of a vertex from bind pose to the pose.
    fn matrix(&self, vertex: usize) -> DMat4 {
        let [Some(first), Some(last)] = [self.matrices.first(), self.matrices.last()] else {
            return DMat4::IDENTITY;
        };
        let words = &self.packed.words[self.packed.offsets.joints as usize + 6 * vertex..][..6];
        let share = f64::from(f32::from_bits(words[4]));
        let matrix = |matrix: &Affine3A| DMat4::from(matrix.as_daffine3());
        matrix(first) * (1.0 - share) + matrix(last) * share
    }

    /// Position, normal and tangent of a vertex of the posed mesh.
    fn expected(&self, vertex: usize) -> [DVec3; 3] {
        let float = |word: u32| f64::from(f32::from_bits(word));
        let (offsets, words) = (self.packed.offsets, &self.packed.words);
        let difference = |part: usize| {
            let at = offsets.morphs as usize + 9 * vertex + 3 * part;
            DVec3::new(float(words[at]), float(words[at + 1]), float(words[at + 2])) * f64::from(self.weight)
        };
        let position = Vec3::from(self.packed.positions()[vertex]).as_dvec3();
        let normal = decode_normal(words[offsets.normals as usize + vertex]);
        let tangent = decode_tangent(words[offsets.tangents as usize + vertex]);
        let matrix = self.matrix(vertex);
        let linear = bevy::math::DMat3::from_mat4(matrix);
        [
            matrix.transform_point3(position + difference(0)),
            (linear.inverse().transpose() * (normal + difference(1))).normalize(),
            (linear * (tangent + difference(2))).normalize(),
        ]
    }

    fn check_vertices(&self, geometry: &[u32]) -> Vec<[f32; 3]> {
        let count = self.packed.vertex_count as usize;
        let posed = &geometry[self.job.posed as usize..];
        let word = |offset: usize| posed[offset];
        let [normals, tangents, motions] = [word(5) as usize, word(6) as usize, word(10) as usize];
        assert_eq!((word(3), normals), (HEADER_WORDS, 12 + 3 * count));
        assert_eq!(
            (word(0), word(1)),
            (self.packed.vertex_count, self.packed.triangle_count)
        );
        let vertices = (0..count).map(|vertex| {
            let [position, normal, tangent] = self.expected(vertex);
            let found = [0, 1, 2].map(|axis| f32::from_bits(word(12 + 3 * vertex + axis)));
            assert!(
                (Vec3::from(found).as_dvec3() - position).length() < 1e-4,
                "{found:?} for {position}"
            );
            let before = before(vertex).as_dvec3();
            let motion = unpack_vector(word(motions + vertex)).as_dvec3();
            assert!(
                (motion - (position - before)).length() < 0.01 * (position - before).length() + 1e-4,
                "moved by {motion}, from {before} to {position}"
            );
            let found_normal = decode_normal(word(normals + vertex));
            assert!((found_normal - normal).length() < 2e-3, "{found_normal} for {normal}");
            let (word, source) = (
                word(tangents + vertex),
                self.packed.words[self.packed.offsets.tangents as usize + vertex],
            );
            assert!(
                (decode_tangent(word) - tangent).length() < 2e-3,
                "{} for {tangent}",
                decode_tangent(word)
            );
            assert_eq!(word >> 31, source >> 31, "handedness");
            found
        });
        let vertices = vertices.collect();
        // Offsets to shared arrays wrap around.
        let indices = self.job.posed.wrapping_add(word(4)) as usize;
        assert_eq!(
            &geometry[indices..][..self.packed.indices().len()],
            self.packed.indices()
        );
        vertices
    }

    fn check_tree(&self, items: &[Item], vertices: &[[f32; 3]]) {
        let tree = &items[self.job.posed_node as usize..][..self.blas.items.len()];
        let (nodes, triangles) = tree.split_at(self.blas.node_count as usize);
        for (found, source) in triangles.iter().zip(&self.blas.items[nodes.len()..]) {
            let name = source[0][3];
            let corners = &self.packed.indices()[3 * name as usize..][..3];
            for (row, corner) in found.iter().zip(corners) {
                assert_eq!(row[..3], vertices[*corner as usize].map(f32::to_bits));
            }
            assert_eq!((found[0][3], found[1][3]), (name, 0));
            let [a, b, c] = found.map(|[x, y, z, _]| Vec3::from([x, y, z].map(f32::from_bits)));
            let scale = 0.25 * ((b - a).length() + (c - a).length());
            assert!((f32::from_bits(found[2][3]) / scale - 1.0).abs() < 1e-5);
        }
        let whole = self.check_node(nodes, triangles, 0);
        assert!(
            (0..3).all(
                |axis| self.job.bounds_min[axis] <= whole.min[axis] && whole.max[axis] <= self.job.bounds_max[axis]
            )
        );
    }

    /// Checks that every box contains all boxes below it with little slack. Returns the exact box of the node.
    fn check_node(&self, nodes: &[Item], triangles: &[Item], index: usize) -> Bounds {
        let (node, source) = (nodes[index], self.blas.items[index]);
        assert_eq!(
            (node[2][2..].to_vec(), node[0][3] >> 24),
            (source[2][2..].to_vec(), source[0][3] >> 24)
        );
        let leaves = node[0][3] >> 24 | node[2][3] >> 28 << 8;
        let (first_inner, inner_count) = (node[2][2] & 0x0fff_ffff, node[2][2] >> 28);
        let mut triangle = (node[2][3] & 0x0fff_ffff) as usize;
        let mut children = Vec::new();
        for slot in 0..4 {
            let count = (leaves >> (3 * slot) & 7).count_ones() as usize;
            if slot < inner_count {
                children.push((slot, self.check_node(nodes, triangles, (first_inner + slot) as usize)));
            } else if count > 0 {
                let corners = triangles[triangle..triangle + count].as_flattened();
                let around = corners.iter().fold(Bounds::EMPTY, |bounds, row| {
                    let corner = [row[0], row[1], row[2]].map(f32::from_bits);
                    bounds.union(Bounds {
                        min: corner,
                        max: corner,
                    })
                });
                children.push((slot, around));
                triangle += count;
            }
        }
        let whole = children
            .iter()
            .fold(Bounds::EMPTY, |bounds, (_, child)| bounds.union(*child));
        let planes = [
            [node[1][0], node[1][1]],
            [node[1][2], node[1][3]],
            [node[2][0], node[2][1]],
        ];
        for axis in 0..3 {
            let step = f64::from(f32::from_bits((node[0][3] >> (8 * axis) & 255) << 23));
            let origin = f64::from(f32::from_bits(node[0][axis]));
            let extent = f64::from(whole.max[axis]) - f64::from(whole.min[axis]);
            assert!(
                step * 127.0 <= extent * 1.01 || step < 1e-20,
                "steps of {step} for {extent}"
            );
            for (slot, child) in &children {
                let [low, difference] = planes[axis].map(|word| word >> (8 * slot) & 255);
                let [low, high] = [low, low ^ difference].map(|plane| origin + f64::from(plane) * step);
                let (min, max) = (f64::from(child.min[axis]), f64::from(child.max[axis]));
                assert!(low <= min && max <= high, "{low} to {high} doesn't hold {min} to {max}");
                assert!(
                    min - low <= 1.001 * step && high - max <= 1.001 * step,
                    "{low} to {high} for {min} to {max}"
                );
            }
        }
        whole
    }
}

fn decode_normal(word: u32) -> DVec3 {
    let snorm = |bits: u32| f32::from(bits as u16 as i16) / 32767.0;
    octahedral_decode_signed(Vec2::new(snorm(word), snorm(word >> 16))).as_dvec3()
}

fn decode_tangent(word: u32) -> DVec3 {
    let x = f32::from(word as u16 as i16) / 32767.0;
    let y = (word >> 16 & 0x7fff) as f32 / 32767.0 * 2.0 - 1.0;
    octahedral_decode_signed(Vec2::new(x, y)).as_dvec3()
}

/// Poses a batch in buffers with these contents. Returns the words of both.
fn pose(
    batch: &Batch,
    geometry: &[u32],
    bvh: &[Item],
    device: &RenderDevice,
    queue: &RenderQueue,
) -> (Vec<u32>, Vec<u32>) {
    let buffer = |contents: &[u8]| -> Buffer {
        device.create_buffer_with_data(&BufferInitDescriptor {
            label: None,
            contents,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_SRC,
        })
    };
    let buffers = [
        buffer(bytemuck::cast_slice(geometry)),
        buffer(bytemuck::cast_slice(bvh)),
    ];
    let mut pass = PosePass::new(device);
    assert!(pass.reserve(batch, device));
    let encoder = pass.record(batch, &kernels(device), buffers.each_ref(), None, device, queue);
    queue.submit([encoder.finish()]);
    let [geometry, bvh] = buffers.map(|buffer| test_gpu::read(device, queue, &buffer));
    (geometry, bvh)
}

#[test]
fn vertices_and_trees_follow_the_pose() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let (mut geometry, mut bvh, mut batch) = (vec![7; 30], vec![Item::default(); 5], Batch::default());
    let turned = Affine3A::from_scale_rotation_translation(
        Vec3::new(1.5, 0.8, 1.0),
        Quat::from_euler(Default::default(), 0.4, 1.2, -0.6),
        Vec3::new(3.0, -20.0, 11.0),
    );
    let mirrored = Affine3A::from_scale(Vec3::new(-1.0, 1.2, 1.0));
    // Trees of different depths are refitted together.
    let subjects = [
        (sheet(40, 30, true), vec![turned, Affine3A::IDENTITY], 0.6),
        (sheet(2, 2, false), vec![], -1.5),
        (sheet(9, 3, true), vec![mirrored, mirrored * turned], 0.0),
        (sheet(90, 70, true), vec![Affine3A::IDENTITY, turned], 0.1),
        (comb(), vec![], 0.0),
    ]
    .map(|(mesh, matrices, weight)| Subject::new(&mesh, matrices, weight, (&mut geometry, &mut bvh), &mut batch));
    let (words, items) = pose(&batch, &geometry, &bvh, &device, &queue);
    let items: &[Item] = bytemuck::cast_slice(&items);
    for subject in &subjects {
        let vertices = subject.check_vertices(&words);
        subject.check_tree(items, &vertices);
        let source = subject.job.source as usize..subject.job.source as usize + subject.packed.words.len();
        assert_eq!(words[source.clone()], geometry[source], "the mesh of the asset stays");
    }
    assert!(subjects[3].blas.levels().len() > subjects[2].blas.levels().len());
}

#[test]
fn the_apps_shader_moves_vertices_in_world_space() {
    let Some((device, queue)) = test_gpu::device() else {
        return;
    };
    let inputs = Inputs {
        seconds: 2.5,
        uniforms: vec![Vec4::splat(9.0), Vec4::new(1.0, -2.0, 3.0, 0.0)],
        version: 1,
    };
    let (mut geometry, mut bvh, mut batch) = (vec![7; 30], vec![Item::default(); 5], Batch::new(Some(&inputs)));
    let skin = vec![Affine3A::from_rotation_x(0.3), Affine3A::from_translation(Vec3::Y)];
    let mut mesh = sheet(9, 3, true);
    let uv = |i: u8| [0.1 * f32::from(i), 2.0 - 0.2 * f32::from(i)];
    let color = |i: u8| [0.5, f32::from(i) / 32.0, 0.25, 1.0];
    mesh.insert_attribute(Mesh::ATTRIBUTE_UV_0, (0..27).map(uv).collect::<Vec<_>>());
    mesh.insert_attribute(Mesh::ATTRIBUTE_COLOR, (0..27).map(color).collect::<Vec<_>>());
    let subject = Subject::new(&mesh, skin, 0.6, (&mut geometry, &mut bvh), &mut batch);
    let still = Subject::new(&sheet(5, 4, false), vec![], 0.4, (&mut geometry, &mut bvh), &mut batch);
    let place = Affine3A::from_scale_rotation_translation(
        Vec3::new(2.0, 0.5, 1.0),
        Quat::from_rotation_y(0.7),
        Vec3::new(4.0, 5.0, -6.0),
    );
    let parameters = Vec4::new(3.0, 0.0, -7.0, 1.0);
    let vertices = ReflectedVertices { reach: 1.0, parameters };
    let motion = Motion::new(place, &vertices).unwrap();
    let mut jobs = core::mem::take(&mut batch.jobs);
    batch.move_vertices(&mut jobs[0], &motion.words(inputs.seconds));
    let bounds = Bounds {
        min: jobs[0].bounds_min,
        max: jobs[0].bounds_max,
    };
    let bounds = enlarged(bounds, motion.reach());
    [jobs[0].bounds_min, jobs[0].bounds_max] = [bounds.min, bounds.max];
    batch.jobs = jobs;
    let (words, _) = pose(&batch, &geometry, &bvh, &device, &queue);
    still.check_vertices(&words);

    let posed = &words[subject.job.posed as usize..];
    let world_from_object = DMat4::from(place.as_daffine3());
    let linear = bevy::math::DMat3::from_mat4(world_from_object);
    for vertex in 0..27_u8 {
        let [position, normal, _] = subject.expected(vertex.into());
        let ([u, v], [red, green, blue, _]) = (uv(vertex), color(vertex));
        let sum = parameters.truncate() * 2.5
            + Vec3::new(1.0, -2.0, 3.0)
            + Vec3::new(u, v, vertex.into())
            + Vec3::new(red, green, blue)
            + Vec3::from(place.translation);
        let moved = world_from_object.transform_point3(position) + 0.01 * sum.as_dvec3();
        let expected = world_from_object.inverse().transform_point3(moved);
        let found = [0, 1, 2].map(|axis| f32::from_bits(posed[12 + 3 * usize::from(vertex) + axis]));
        let found = Vec3::from(found).as_dvec3();
        assert!((found - expected).length() < 1e-3, "{found} for {expected}");
        let turned = (linear.inverse().transpose() * normal).normalize();
        let expected = (linear.transpose() * DVec3::new(turned.z, turned.x, turned.y)).normalize();
        let found = decode_normal(posed[posed[5] as usize + usize::from(vertex)]);
        assert!((found - expected).length() < 2e-3, "{found} for {expected}");
    }
}

#[test]
fn triangles_without_area_in_bind_pose_are_kept() {
    let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [f32::NAN; 3]];
    let indices = [0, 1, 2, 0, 1, 3];
    let blas = build_posable_blas(&positions, &indices, BvhQuality::Medium).unwrap();
    assert_eq!(blas.triangle_count, 1);
    assert_eq!(blas.levels(), [0, 1]);
}
