//! Particles: quads that face the viewer of the mirror's image, as real quads face the mirrored camera.

use super::{EDGES, LEVELS, Row, Stage, blue};
use crate::{
    pictures::{apps, differing_pixels, warm_up},
    stage::{BEFORE_THE_MIRROR, SIZE, add, spawn_mesh},
};
use bevy::{camera::visibility::RenderLayers, light::NotShadowCaster, math::Affine2, prelude::*};
use bevy_glint::{NotReflected, ReflectedLayers, ReflectedParticle, ReflectedParticles, ReflectionTechnique};
use glint_scenes::Output;

pub(super) const ROWS: [Row; 12] = [
    ("blended particles", |stage| {
        stage.spawn_burst(AlphaMode::Blend, true);
    }),
    ("premultiplied particles", |stage| {
        stage.spawn_burst(AlphaMode::Premultiplied, true);
    }),
    ("added particles", |stage| stage.spawn_burst(AlphaMode::Add, true)),
    ("multiplied particles", |stage| {
        stage.spawn_burst(AlphaMode::Multiply, true);
    }),
    ("masked particles", |stage| {
        stage.spawn_burst(AlphaMode::Mask(0.5), true);
    }),
    ("opaque particles, lit", |stage| {
        stage.spawn_burst(AlphaMode::Opaque, false);
    }),
    ("blended particles, lit", |stage| {
        // Bevy lights blended surfaces with the normal of the prepass behind them, which is nearly the same on a wall.
        stage.sun = Vec3::Z;
        stage.spawn_back();
        stage.spawn_particles(AlphaMode::Blend, false);
    }),
    ("masked particles, lit, by mirrors' own rays", |stage| {
        stage.show_layers();
        stage.spawn_burst(AlphaMode::Mask(0.5), false);
    }),
    ("blended particles, at rest", |stage| {
        stage.technique = ReflectionTechnique::Converged;
        stage.frames = 4;
        stage.spawn_burst(AlphaMode::Blend, true);
    }),
    ("opaque particles, lit, on paths of two bounces", |stage| {
        stage.bounces = 2;
        stage.spawn_burst(AlphaMode::Opaque, false);
    }),
    ("particles in the shadow of a wall", |stage| {
        // The sun comes from the side of the wall, which is out of sight.
        stage.add_sun(3000.0, true, Vec3::new(1.0, -0.1, 0.4), ());
        let at = Transform::from_xyz(-8.0, 0.0, 5.0);
        stage.put(Cuboid::new(0.2, 30.0, 7.0), blue(), at);
        stage.spawn(blue());
        stage.spawn_particles(AlphaMode::Opaque, false);
    }),
    ("particles in fog", |stage| {
        stage.spawn_in_fog(FogFalloff::Exponential { density: 0.1 }, Color::NONE);
        stage.spawn_particles(AlphaMode::Blend, true);
    }),
];

/// A burst in front of the objects and partly behind them.
fn burst() -> Vec<ReflectedParticle> {
    let particle = |index: u8| {
        let [x, y, z] = [0.754_877_7, 0.569_840_3, 0.412_454].map(|step| (0.5 + step * f32::from(index)).fract());
        ReflectedParticle {
            position: Vec3::new(6.0 * x - 3.0, 3.4 * y - 1.7, 3.6 + 5.0 * z),
            size: Vec2::new(0.6 + 0.8 * z, 0.7 + 0.7 * x),
            rotation: 2.0 * y - 1.0,
            color: LinearRgba::new(0.3 + 0.7 * x, 0.3 + 0.7 * y, 0.3 + 0.7 * z, 0.4 + 0.6 * x),
        }
    };
    (0..16).map(particle).collect()
}

/// The same quad for Bevy, which faces the mirrored camera.
fn quad(particle: &ReflectedParticle) -> Transform {
    let viewer = -BEFORE_THE_MIRROR.translation;
    let facing = Transform::from_translation(particle.position).looking_to(particle.position - viewer, Vec3::Y);
    let turned = facing.with_rotation(facing.rotation * Quat::from_rotation_z(particle.rotation));
    turned.with_scale(particle.size.extend(1.0))
}

/// A material in the colour of a particle.
fn tinted(material: &StandardMaterial, color: LinearRgba) -> StandardMaterial {
    let own = LinearRgba::from(material.base_color).to_vec4() * color.to_vec4();
    StandardMaterial {
        base_color: LinearRgba::from_vec4(own).into(),
        emissive: LinearRgba::from_vec3(material.emissive.to_vec3() * color.to_vec3()),
        ..material.clone()
    }
}

impl Stage<'_> {
    fn spawn_burst(&mut self, alpha_mode: AlphaMode, unlit: bool) {
        self.light_and_spawn(blue());
        self.spawn_particles(alpha_mode, unlit);
    }

    /// A white wall in sunlight.
    fn spawn_back(&mut self) {
        self.light_and_spawn(blue());
        let back = self.spawned.pop().unwrap();
        for object in self.spawned.split_off(1) {
            self.app.world().despawn(object);
        }
        self.spawned.push(back);
    }

    /// Particles for reflections, and quads for the camera.
    fn spawn_particles(&mut self, alpha_mode: AlphaMode, unlit: bool) {
        let is_masked = matches!(alpha_mode, AlphaMode::Mask(_));
        let alpha = if is_masked { 0 } else { 90 };
        let texture = self.checkers([255, 200, 150, 255], [120, 160, 255, alpha], true);
        let material = StandardMaterial {
            base_color: Color::linear_rgba(0.9, 0.7, 0.6, 0.9),
            base_color_texture: Some(texture),
            // Few borders: if colours change from pixel to pixel, half a pixel makes a difference.
            uv_transform: Affine2::from_scale(Vec2::new(0.25, 0.375)),
            emissive: LinearRgba::rgb(0.2, 0.1, 0.05),
            perceptual_roughness: 0.7,
            alpha_mode,
            unlit,
            ..default()
        };
        let mut particles = burst();
        if is_masked {
            particles.iter_mut().for_each(|particle| particle.color.alpha = 1.0);
        }
        for particle in &particles {
            let material = tinted(&material, particle.color);
            let entity = self.put(Rectangle::new(1.0, 1.0), material, quad(particle));
            let own = (NotReflected, NotShadowCaster);
            self.app.world().entity_mut(entity).insert(own);
        }
        let material = add(self.app, material);
        self.add(ReflectedParticles { particles, material });
    }

    /// Entities of all particles, which are the last to be spawned.
    fn particles(&self) -> Entity {
        *self.spawned.last().unwrap()
    }
}

#[test]
fn particles_come_move_and_go() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let mut stage = Stage::new(&mut app);
        stage.light_and_spawn(blue());
        let without = stage.in_the_mirror();
        stage.spawn_particles(AlphaMode::Blend, true);
        let with = stage.in_the_mirror();
        let apart = |a: &[u8], b: &[u8]| differing_pixels(a, b, LEVELS);
        assert!(apart(&without, &with) > 500, "{tracer}: {}", apart(&without, &with));
        let entity = stage.particles();

        // All of them by a step of their entity, then back by their own positions.
        stage.dress_particles(entity, Transform::from_xyz(0.7, 0.0, 0.0));
        let moved = stage.capture();
        assert!(apart(&moved, &with) > 300, "{tracer}: the entity moves");
        let world = stage.app.world();
        let mut particles = world.get_mut::<ReflectedParticles>(entity).unwrap();
        particles
            .particles
            .iter_mut()
            .for_each(|particle| particle.position.x -= 0.7);
        assert!(apart(&stage.capture(), &with) <= EDGES, "{tracer}: particles move");

        // One that isn't a number takes no others away.
        let mut particles = stage.app.world().get_mut::<ReflectedParticles>(entity).unwrap();
        let mut invalid = particles.particles[0];
        invalid.position.y = f32::NAN;
        particles.particles.push(invalid);
        assert!(
            apart(&stage.capture(), &with) <= EDGES,
            "{tracer}: an invalid one is left out"
        );

        stage.dress_particles(entity, Visibility::Hidden);
        assert_eq!(apart(&stage.capture(), &without), 0, "{tracer}: hidden");
        stage.dress_particles(entity, Visibility::Visible);
        assert!(apart(&stage.capture(), &with) <= EDGES, "{tracer}: shown again");
        stage.dress_particles(entity, RenderLayers::layer(3));
        assert_eq!(apart(&stage.capture(), &without), 0, "{tracer}: on another layer");
        stage.dress(ReflectedLayers(RenderLayers::from_layers(&[0, 3])));
        warm_up(stage.app);
        assert!(
            apart(&stage.capture(), &with) <= EDGES,
            "{tracer}: on the reflected layers"
        );
        stage.app.world().entity_mut(stage.camera).remove::<ReflectedLayers>();
        stage.app.world().entity_mut(entity).remove::<RenderLayers>();
        warm_up(stage.app);
        assert!(
            apart(&stage.capture(), &with) <= EDGES,
            "{tracer}: on no layer of its own"
        );

        // A wall between the mirror and the particles, close behind the camera.
        let wall = Transform::from_xyz(0.0, 0.0, 3.3);
        let wall = spawn_mesh(stage.app, Cuboid::new(40.0, 40.0, 0.1), blue(), wall);
        let hidden = stage.in_the_mirror();
        stage.app.world().entity_mut(entity).remove::<ReflectedParticles>();
        let bare = stage.capture();
        assert_eq!(apart(&bare, &hidden), 0, "{tracer}: behind a wall");
        stage.app.world().despawn(wall);
        stage.in_the_mirror();
        assert_eq!(apart(&stage.capture(), &without), 0, "{tracer}: removed");
    }
}

impl Stage<'_> {
    fn dress_particles(&mut self, entity: Entity, bundle: impl Bundle) {
        self.app.world().entity_mut(entity).insert(bundle);
    }
}
