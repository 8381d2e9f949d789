//! The mirror suite: a scene in a perfect mirror looks like the same scene to the mirrored camera, whatever the scene contains. The
//! manual's table of reflected features (`src/manual/interactions.md`) has a line for each row.

mod basics;
mod coplanar;
mod decals;
mod far;
mod haze;
mod light;
mod light_textures;
mod materials;
mod particles;
mod random;
mod sky;
mod transmission;
mod vertices;

use crate::{
    pictures::{PATIENCE, apps, differing_pixels, dump, flip, reflect, warm_up},
    stage::{
        BEFORE_THE_MIRROR, SIZE, add, behind, edit_material, image, metal, settings_of, spawn_camera, spawn_mesh, wall,
    },
};
use bevy::{
    camera::{Exposure, visibility::RenderLayers},
    core_pipeline::prepass::NormalPrepass,
    image::Image,
    light::NotShadowCaster,
    pbr::{Lightmap, ScreenSpaceTransmission},
    prelude::*,
    render::render_resource::TextureFormat,
};
use bevy_glint::{RayTracedReflections, ReflectionTechnique};
use glint_scenes::{HeadlessApp, Output, SceneName};

/// Mean FLIP up to which both images are the same ...
const LIMIT: f32 = 0.01;
/// ... and maximum number of levels: FLIP sees single ones of 255 in smooth skies and on walls in coloured light, where they depend on
/// rounding ...
const LEVELS: u8 = 3;
/// ... except for this number of pixels, on edges.
const EDGES: usize = 4;

const FOG: Color = Color::linear_rgb(0.1, 0.3, 0.2);
const SUN: Vec3 = Vec3::new(0.5, -0.2, 1.0);

/// A feature, and a function that adds it.
type Row = (&'static str, fn(&mut Stage));

fn blue() -> StandardMaterial {
    StandardMaterial {
        base_color: Color::linear_rgb(0.1, 0.3, 0.8),
        perceptual_roughness: 0.5,
        ..default()
    }
}

/// A camera before a mirror that fills its view, and the objects behind the camera.
struct Stage<'a> {
    app: &'a mut HeadlessApp,
    camera: Entity,
    mirror: Entity,
    spawned: Vec<Entity>,
    material: StandardMaterial,
    fog_color: Color,
    /// Technique for the image in the mirror, and its number of frames.
    technique: ReflectionTechnique,
    /// Exact mirrors have their own rays.
    own_rays: bool,
    /// Number of hits of a ray, each with its own reflection.
    bounces: u32,
    /// A second mirror, in which the first one shows the scene.
    second: Option<Entity>,
    frames: u32,
    /// Pixels of an image in a line.
    width: u32,
    /// Direction of the light. The default comes from behind the mirror and doesn't light it.
    sun: Vec3,
}

impl<'a> Stage<'a> {
    fn new(app: &'a mut HeadlessApp) -> Self {
        let mirror = spawn_mesh(app, wall(), metal(0.0), Transform::IDENTITY);
        app.world().entity_mut(mirror).insert(NotShadowCaster);
        let camera = spawn_camera(app, BEFORE_THE_MIRROR, SceneName::MirrorRoom);
        app.world().entity_mut(camera).insert(Exposure::default());
        Self {
            app,
            camera,
            mirror,
            spawned: Vec::new(),
            material: blue(),
            fog_color: FOG,
            technique: ReflectionTechnique::Reference,
            own_rays: false,
            bounces: 1,
            second: None,
            frames: 2,
            width: SIZE.x,
            sun: SUN,
        }
    }

    fn set_fog_before_the_mirror(&mut self, enabled: bool) {
        edit_material(self.app, self.mirror, |material| material.fog_enabled = enabled);
    }

    fn add(&mut self, bundle: impl Bundle) {
        let entity = self.app.world().spawn(bundle).id();
        self.spawned.push(entity);
    }

    fn put(&mut self, mesh: impl Into<Mesh>, material: StandardMaterial, at: Transform) -> Entity {
        let entity = spawn_mesh(self.app, mesh, material, at);
        self.spawned.push(entity);
        entity
    }

    /// Gives the camera a component.
    fn dress(&mut self, bundle: impl Bundle) {
        self.app.world().entity_mut(self.camera).insert(bundle);
    }

    /// Gives a component to everything that was spawned.
    fn dress_spawned(&mut self, bundle: impl Bundle + Clone) {
        for &entity in &self.spawned {
            self.app.world().entity_mut(entity).insert(bundle.clone());
        }
    }

    /// A sun that shines in a direction. `more` is its other components.
    fn add_sun(&mut self, illuminance: f32, shadow_maps_enabled: bool, direction: Vec3, more: impl Bundle) {
        let sun = DirectionalLight {
            illuminance,
            shadow_maps_enabled,
            ..default()
        };
        self.add((sun, Transform::default().looking_to(direction, Vec3::Y), more));
    }

    fn add_sun_with_shadows(&mut self, layers: RenderLayers) {
        self.add_sun(2000.0, true, SUN, layers);
    }

    /// Objects of one material behind the camera, near and far, with their fronts towards the mirror.
    fn spawn(&mut self, material: StandardMaterial) {
        let white = StandardMaterial {
            base_color: Color::WHITE,
            fog_enabled: material.fog_enabled,
            ..blue()
        };
        let sphere = Sphere::new(1.2).mesh().uv(32, 18).with_generated_tangents();
        let cuboid = Mesh::from(Cuboid::from_length(1.8)).with_generated_tangents();
        let back = Mesh::from(Rectangle::new(60.0, 60.0)).with_generated_tangents();
        let things = [
            (sphere, &material, Transform::from_xyz(-1.2, 0.4, 7.0)),
            (
                cuboid,
                &material,
                Transform::from_xyz(2.0, -0.6, 8.5).with_rotation(Quat::from_rotation_y(0.6)),
            ),
            (back, &white, behind(12.0)),
        ];
        for (mesh, material, at) in things {
            self.put(mesh.unwrap(), material.clone(), at);
        }
    }

    /// Like `spawn`, with sunlight.
    fn light_and_spawn(&mut self, material: StandardMaterial) {
        self.add_sun(2000.0, false, self.sun, ());
        self.spawn(material);
    }

    /// A sphere and a block twice as wide as deep, before two colours.
    fn spawn_thick_glass(&mut self) {
        self.dress(ScreenSpaceTransmission::default());
        let material = StandardMaterial {
            base_color: Color::WHITE,
            specular_transmission: 1.0,
            thickness: 0.8,
            ior: 1.4,
            attenuation_distance: 1.0,
            attenuation_color: Color::srgb(0.4, 0.9, 0.8),
            perceptual_roughness: 0.0,
            reflectance: 0.0,
            ..blue()
        };
        let checkered = StandardMaterial {
            base_color_texture: Some(self.checkers([230, 160, 60, 255], [120, 180, 230, 255], true)),
            unlit: true,
            ..default()
        };
        let block = Transform::from_xyz(2.0, -0.6, 8.5).with_rotation(Quat::from_rotation_y(0.6));
        let things: [(Mesh, _, _); 3] = [
            (
                Sphere::new(1.2).mesh().uv(64, 36),
                &material,
                Transform::from_xyz(-1.2, 0.4, 7.0),
            ),
            (
                Cuboid::from_length(1.0).into(),
                &material,
                block.with_scale(Vec3::new(2.0, 2.0, 1.0)),
            ),
            (Rectangle::new(24.0, 20.0).into(), &checkered, behind(12.0)),
        ];
        for (mesh, material, at) in things {
            self.put(mesh, material.clone(), at);
        }
    }

    /// A sheet with its back towards the mirror, without tangents. With tangents Bevy would not turn its normals.
    fn turn_a_back(&mut self, material: StandardMaterial) {
        let at = Transform::from_xyz(0.6, 1.6, 7.5).with_rotation(Quat::from_rotation_y(0.3));
        self.put(Rectangle::new(1.6, 1.6), material, at);
    }

    /// Spawns objects with a lightmap of two colours.
    fn spawn_baked(&mut self, material: StandardMaterial) {
        let image = self.checkers([255, 150, 40, 255], [20, 60, 200, 255], true);
        self.spawn(material);
        self.bake(&image);
    }

    /// Gives the spawned objects a part of a lightmap.
    fn bake(&mut self, image: &Handle<Image>) {
        let world = self.app.world();
        for &entity in &self.spawned {
            let mesh = world.get::<Mesh3d>(entity).unwrap().id();
            let lightmap = Lightmap {
                image: image.clone(),
                uv_rect: Rect::new(0.1, 0.2, 0.9, 0.7),
                ..default()
            };
            world.entity_mut(entity).insert(lightmap);
            let mut meshes = world.resource_mut::<Assets<Mesh>>();
            let mut mesh = meshes.get_mut(mesh).unwrap();
            let uvs = mesh.attribute(Mesh::ATTRIBUTE_UV_0).unwrap().clone();
            mesh.insert_attribute(Mesh::ATTRIBUTE_UV_1, uvs);
        }
    }

    fn spawn_in_fog(&mut self, falloff: FogFalloff, directional_light_color: Color) {
        self.dress(DistanceFog {
            color: self.fog_color,
            falloff,
            directional_light_color,
            directional_light_exponent: 1.0,
        });
        self.light_and_spawn(self.material.clone());
    }

    /// An image of two colours, in squares.
    fn checkers(&mut self, even: [u8; 4], odd: [u8; 4], srgb: bool) -> Handle<Image> {
        let color = |i: u32| if (i % 8 + i / 8).is_multiple_of(2) { even } else { odd };
        let format = if srgb {
            TextureFormat::Rgba8UnormSrgb
        } else {
            TextureFormat::Rgba8Unorm
        };
        let texels = (0..64).flat_map(color).collect();
        add(self.app, image(UVec2::splat(8), format, texels))
    }

    fn capture(&mut self) -> Vec<u8> {
        self.app.step(self.frames);
        self.app.capture().unwrap()
    }

    /// The image in the mirror.
    fn in_the_mirror(&mut self) -> Vec<u8> {
        reflect(self.app, self.camera, self.technique);
        if self.own_rays || self.bounces > 1 {
            let mut settings = settings_of(self.app, self.camera);
            settings.full_resolution_mirrors = self.own_rays;
            settings.max_bounces = self.bounces;
            warm_up(self.app);
        }
        self.capture()
    }

    /// The image of the mirrored camera, mirrored back unless two mirrors did that.
    fn by_the_mirrored_camera(&mut self) -> Vec<u8> {
        let behind = Transform::from_translation(-BEFORE_THE_MIRROR.translation).looking_to(Vec3::Z, Vec3::Y);
        self.dress(if self.second.is_some() {
            haze::BEHIND_BOTH
        } else {
            behind
        });
        let world = self.app.world();
        // With a normal prepass, Bevy lights blended surfaces by the normals of what is behind them.
        world
            .entity_mut(self.camera)
            .remove::<(RayTracedReflections, NormalPrepass)>();
        for mirror in [Some(self.mirror), self.second].into_iter().flatten() {
            world.entity_mut(mirror).insert(Visibility::Hidden);
        }
        // Nothing reflects, so only Bevy's own pipelines and textures are awaited.
        self.app.warm_up(PATIENCE).unwrap();
        let picture = self.capture();
        self.app.world().entity_mut(self.mirror).insert(Visibility::Visible);
        self.dress(BEFORE_THE_MIRROR);
        if self.second.is_some() {
            return picture;
        }
        let lines = picture.chunks_exact(4 * self.width as usize);
        lines
            .flat_map(|line| line.chunks_exact(4).rev())
            .flatten()
            .copied()
            .collect()
    }

    /// Pixels in which a mirror with only a reflection probe around it differs from Bevy's own image of it. They all have a colour, and
    /// FLIP sees single levels of dim colours, so levels are counted.
    fn miss_within_a_probe(&mut self) -> usize {
        // Bevy adds ambient light to the colour of a mirror, and reflections replace that light.
        self.dress(AmbientLight {
            brightness: 0.0,
            ..default()
        });
        self.surround();
        self.add_probe(
            Transform::from_xyz(0.5, 0.0, 1.0).with_scale(Vec3::splat(5.0)),
            0,
            Quat::IDENTITY,
        );
        let actual = self.in_the_mirror();
        self.app
            .world()
            .entity_mut(self.camera)
            .remove::<RayTracedReflections>();
        self.app.warm_up(PATIENCE).unwrap();
        let expected = self.capture();
        let different = differing_pixels(&expected, &actual, 3);
        if different > 0 {
            dump("mirror in a probe", SIZE, &expected, &actual);
        }
        self.clear();
        different
    }

    fn clear(&mut self) {
        for entity in self.spawned.drain(..) {
            self.app.world().despawn(entity);
        }
        let mut camera = self.app.world().entity_mut(self.camera);
        camera.remove::<(
            DistanceFog,
            AmbientLight,
            ScreenSpaceTransmission,
            EnvironmentMapLight,
            RenderLayers,
        )>();
        camera.remove::<sky::Components>();
        self.material = blue();
        self.fog_color = FOG;
        self.technique = ReflectionTechnique::Reference;
        self.own_rays = false;
        self.bounces = 1;
        self.second = None;
        self.frames = 2;
        self.sun = SUN;
        self.set_fog_before_the_mirror(true);
    }
}

#[test]
fn a_scene_in_a_mirror_looks_like_itself() {
    for (tracer, mut app) in apps(SIZE, Output::Picture) {
        let mut stage = Stage::new(&mut app);
        let mut failures = Vec::new();
        let lights = light::ROWS.into_iter().chain(light_textures::ROWS);
        let others = lights.chain(sky::ROWS).chain(transmission::ROWS);
        let filter = std::env::var("GLINT_ROWS").unwrap_or_default();
        let rows = basics::ROWS
            .into_iter()
            .chain(others)
            .chain(haze::ROWS)
            .chain(materials::ROWS)
            .chain(particles::ROWS)
            .chain(coplanar::ROWS)
            .chain(decals::ROWS);
        for (name, spawn) in rows.filter(|(name, _)| name.contains(&filter)) {
            spawn(&mut stage);
            let actual = stage.in_the_mirror();
            let expected = stage.by_the_mirrored_camera();
            let error = flip(SIZE, &expected, &actual).0;
            let shown = expected
                .chunks_exact(4)
                .filter(|pixel| pixel[..3] != expected[..3])
                .count();
            let apart = differing_pixels(&expected, &actual, LEVELS);
            println!("{tracer}, {name}: FLIP {error:.4}, {apart} of {shown} pixels apart");
            if !((error <= LIMIT || apart <= EDGES) && shown > 200) {
                let folder = dump(&format!("mirror {name}"), SIZE, &expected, &actual);
                failures.push(format!(
                    "{name}: FLIP {error:.4}, {apart} pixels apart, {shown} show anything; see {}",
                    folder.display()
                ));
            }
            stage.clear();
        }
        let different = stage.miss_within_a_probe();
        println!("{tracer}, rays that miss in a reflection probe: {different} pixels differ");
        if different > 0 {
            failures.push(format!(
                "rays that miss in a reflection probe: {different} pixels differ"
            ));
        }
        assert!(failures.is_empty(), "{tracer}: {failures:#?}");
    }
}
