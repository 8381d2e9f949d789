//! Compares micromaps with samples of the texture.

use super::*;

/// Uniform pseudorandom numbers from 0 to 1.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / (1u64 << 31) as f64
    }

    fn place(&mut self) -> [f64; 2] {
        let (x, y) = (self.next(), self.next());
        if x + y > 1.0 { [1.0 - x, 1.0 - y] } else { [x, y] }
    }
}

/// Blobs with soft and hard edges.
fn image(width: u32, height: u32, numbers: &mut Numbers) -> AlphaTexels {
    let blobs: Vec<[f64; 4]> = (0..5).map(|_| core::array::from_fn(|_| numbers.next())).collect();
    let texel = |x: u32, y: u32| {
        let at = DVec2::new(
            (f64::from(x) + 0.5) / f64::from(width),
            (f64::from(y) + 0.5) / f64::from(height),
        );
        let inside = |[x, y, size, softness]: &[f64; 4]| {
            let distance = at.distance(DVec2::new(*x, *y));
            ((0.3 * size - distance) / (0.001 + 0.2 * softness) + 0.5).clamp(0.0, 1.0)
        };
        (blobs.iter().map(inside).fold(0.0, f64::max) * 255.0).round() as u8
    };
    AlphaTexels {
        width,
        height,
        texels: (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| texel(x, y))
            .collect(),
    }
}

/// Samples an image with a linear filter.
fn sample(image: &AlphaTexels, wrap: [Wrap; 2], at: DVec2) -> f64 {
    let place = at - 0.5;
    let (first, part) = (place.floor(), place - place.floor());
    let texel = |dx: i64, dy: i64| {
        let x = wrapped(first.x as i64 + dx, image.width.into(), wrap[0]);
        let y = wrapped(first.y as i64 + dy, image.height.into(), wrap[1]);
        f64::from(image.texels[y * image.width as usize + x]) / 255.0
    };
    let row = |dy: i64| texel(0, dy) * (1.0 - part.x) + texel(1, dy) * part.x;
    row(0) * (1.0 - part.y) + row(1) * part.y
}

#[test]
fn what_is_known_is_what_the_alpha_test_says() {
    let mut numbers = Numbers(7);
    let (mut known, mut all) = (0, 0);
    for case in 0..300u32 {
        let image = image(
            1 + (numbers.next() * 60.0) as u32,
            1 + (numbers.next() * 60.0) as u32,
            &mut numbers,
        );
        let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
        let wrap = [wraps[case as usize % 3], wraps[case as usize / 3 % 3]];
        let texture = Arc::new(image);
        let test = AlphaTest {
            alpha: if case % 4 == 0 { 0.8 } else { 1.0 },
            cutoff: [0.5, 0.3, 0.75][case as usize % 3],
            texture: Some((texture.clone(), wrap)),
        };
        let reach = [0.2, 1.0, 5.0][case as usize / 9 % 3];
        let uvs: [[f32; 2]; 3] =
            core::array::from_fn(|_| [(); 2].map(|()| ((numbers.next() * 2.0 - 1.0) * reach) as f32));
        let map = OpacityBaker::new(&test).micromap(Some(uvs), 0x00ff_ffff);
        let corners = uvs.map(|uv| Vec2::from(uv).as_dvec2());
        let size = DVec2::new(texture.width.into(), texture.height.into());
        for _ in 0..2000 {
            let [second, third] = numbers.place();
            let uv = corners[0] + (corners[1] - corners[0]) * second + (corners[2] - corners[0]) * third;
            let alpha = f64::from(test.alpha) * sample(&texture, wrap, uv * size);
            let state = state_of(&map, micro_triangle(second as f32, third as f32));
            let right = match state {
                OPAQUE => alpha >= f64::from(test.cutoff),
                TRANSPARENT => alpha < f64::from(test.cutoff),
                _ => true,
            };
            assert!(right, "{case}: {state} at {second} {third}, where alpha is {alpha}");
            known += u32::from(state != UNKNOWN);
            all += 1;
        }
    }
    assert!(known * 2 > all, "only {known} of {all} places are known");
}

#[test]
fn micro_triangles_stand_in_order() {
    let all: Vec<_> = micro_triangles().collect();
    assert_eq!(all.len(), 64);
    for (index, points) in all.iter().enumerate() {
        let mean = |part: fn((u32, u32)) -> u32| points.iter().map(|p| part(*p)).sum::<u32>() as f32 / 24.0;
        assert_eq!(micro_triangle(mean(|p| p.0), mean(|p| p.1)), index as u32);
    }
    // Rounded weights can lie slightly outside the triangle.
    for (second, third) in [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.500_000_06, 0.5), (1.0, 1.0)] {
        assert!(micro_triangle(second, third) < 64);
    }
}

#[test]
fn what_needs_no_texture() {
    let plain = |alpha: f32, cutoff: f32| AlphaTest {
        alpha,
        cutoff,
        texture: None,
    };
    let state = |test: &AlphaTest, vertex_alpha: u32| {
        common_state(&OpacityBaker::new(test).micromap(Some([[0.0; 2]; 3]), vertex_alpha))
    };
    assert_eq!(state(&plain(1.0, 0.5), 0x00ff_ffff), Some(OPAQUE));
    assert_eq!(state(&plain(0.4, 0.5), 0x00ff_ffff), Some(TRANSPARENT));
    assert_eq!(state(&plain(0.5, 0.5), 0x00ff_ffff), Some(UNKNOWN), "rounding decides");
    assert_eq!(
        state(&plain(0.0, 0.0), 0x00ff_ffff),
        Some(OPAQUE),
        "nothing is below the cut-off"
    );
    assert_eq!(state(&plain(1.0, 0.5), 0x00ff_80ff), Some(UNKNOWN), "0x80 is too near");
    assert_eq!(state(&plain(1.0, 0.5), 0x00ff_00ff), Some(UNKNOWN), "it varies");
    assert_eq!(state(&plain(1.0, 0.5), 0x0010_2000), Some(TRANSPARENT));
    assert_eq!(state(&plain(f32::NAN, 0.5), 0x00ff_ffff), Some(UNKNOWN));
    assert_eq!(state(&plain(1.0, f32::NAN), 0x00ff_ffff), Some(UNKNOWN));
    assert_eq!(state(&plain(1.0, 1.5), 0x00ff_ffff), Some(TRANSPARENT));

    let textured = |width: u32, height: u32, texels: Vec<u8>| {
        let image = AlphaTexels { width, height, texels };
        AlphaTest {
            texture: Some((Arc::new(image), [Wrap::Repeat; 2])),
            ..plain(1.0, 0.5)
        }
    };
    let broken = textured(3, 2, vec![255; 5]);
    assert_eq!(state(&broken, 0x00ff_ffff), Some(UNKNOWN));
    let white = textured(3, 2, vec![255; 6]);
    let baker = OpacityBaker::new(&white);
    assert_eq!(
        common_state(&baker.micromap(Some([[f32::NAN; 2]; 3]), 0x00ff_ffff)),
        Some(OPAQUE),
        "it's all the same"
    );
    let half = textured(2, 1, vec![255, 0]);
    let baker = OpacityBaker::new(&half);
    for far in [f32::NAN, f32::INFINITY, 1e30, 1e6] {
        let map = baker.micromap(Some([[0.0, 0.0], [far, 0.0], [0.0, 1.0]]), 0x00ff_ffff);
        assert_eq!(common_state(&map), Some(UNKNOWN), "{far}");
    }
}

#[test]
fn boxes_hold_what_rays_may_hit() {
    let mut numbers = Numbers(3);
    for _ in 0..200 {
        let corners: [[f32; 3]; 3] =
            core::array::from_fn(|_| core::array::from_fn(|_| (numbers.next() * 4.0 - 2.0) as f32));
        let map: Micromap = core::array::from_fn(|_| {
            (0..16).fold(0, |word, i| {
                word | (if numbers.next() < 0.9 { TRANSPARENT } else { OPAQUE }) << (2 * i)
            })
        });
        let bounds = solid_bounds(&map, &corners);
        let [a, b, c] = corners.map(Vec3A::from);
        for _ in 0..500 {
            let [second, third] = numbers.place().map(|weight| weight as f32);
            if state_of(&map, micro_triangle(second, third)) != TRANSPARENT {
                let point = a + (b - a) * second + (c - a) * third;
                let bounds = bounds.expect("something can be hit");
                assert!(Vec3A::from(bounds.min).cmple(point).all() && point.cmple(Vec3A::from(bounds.max)).all());
            }
        }
    }
    assert_eq!(solid_bounds(&uniform(TRANSPARENT), &[[0.0; 3]; 3]), None);
    let [low, high] = [[0.0, 0.0, 5.0], [1.0, 1.0, 5.0]];
    let whole = solid_bounds(&uniform(UNKNOWN), &[low, [1.0, 0.0, 5.0], [0.0, 1.0, 5.0]]).expect("all of it");
    assert!(
        (0..3).all(|axis| (whole.min[axis] - low[axis]).abs() < 0.01 && (whole.max[axis] - high[axis]).abs() < 0.01)
    );
}
