//! Materials of the street: few textures, many dyes.

use super::surfaces;
use crate::prelude::*;

/// A material asset.
pub type Material = Handle<StandardMaterial>;

/// The materials by their use.
pub struct Materials {
    /// The wet roadway.
    pub asphalt: Material,
    /// The side street.
    pub setts: Material,
    /// Pavements.
    pub slabs: Material,
    /// Kerbs and setts along them.
    pub granite: Material,
    /// White lines on the roadway.
    pub marking: Material,
    /// House fronts: plaster first, then brick, then stone.
    pub walls: Vec<Material>,
    /// Cut stone around openings, on cornices: light and grey.
    pub trims: [Material; 2],
    /// Painted wood of windows, doors and shops.
    pub woodwork: [Material; 6],
    /// Painted wood of shutters.
    pub shutters: [Material; 4],
    /// Dark windows.
    pub panes: [Material; 2],
    /// Lit windows.
    pub lit_panes: [Material; 3],
    /// Dark shop windows.
    pub shop_pane: Material,
    /// Lit shop windows.
    pub lit_shop_panes: [Material; 3],
    /// Boards with a word over shops.
    pub boards: [Material; 3],
    /// The board of the café.
    pub menu: Material,
    /// Awning cloth, seen from both sides.
    pub awnings: [Material; 3],
    /// Parasols and pennants, seen from both sides.
    pub cloths: [Material; 4],
    /// Clay roof tiles.
    pub tiles: [Material; 2],
    /// Slates.
    pub slate: Material,
    /// Sheet metal on roofs, gutters and pipes.
    pub zinc: Material,
    /// Chimneys.
    pub brick: Material,
    /// Pots.
    pub terracotta: Material,
    /// Wrought and cast iron, painted.
    pub iron: Material,
    /// Cast iron in the roadway, bare.
    pub cast_iron: Material,
    /// Polished metal.
    pub chrome: Material,
    /// Brushed metal.
    pub steel: Material,
    /// Door handles and rails.
    pub brass: Material,
    /// Trunks.
    pub bark: Material,
    /// Leaves, seen from both sides and cut out.
    pub leaves: [Material; 3],
    /// Petals, seen from both sides.
    pub petals: [Material; 3],
    /// Earth in planters.
    pub soil: Material,
    /// Car bodies.
    pub cars: [Material; 4],
    /// Plain glossy paint of scooters, bicycles and posts.
    pub enamels: [Material; 5],
    /// Windows of cars.
    pub car_glass: Material,
    /// Tyres.
    pub rubber: Material,
    /// Seats.
    pub leather: Material,
    /// Tail lights.
    pub red_glass: Material,
    /// Café tables.
    pub marble: Material,
    /// Woven seats.
    pub wicker: Material,
    /// Bare wood.
    pub oak: Material,
    /// Plates and cups.
    pub porcelain: Material,
    /// Bottles.
    pub bottles: [Material; 3],
    /// Drinking glasses and headlights.
    pub clear_glass: Material,
    /// Fruit.
    pub fruits: [Material; 3],
    /// Bulbs on strings.
    pub bulbs: [Material; 2],
    /// Lamps.
    pub lamp: Material,
    /// Neon tubes: red, green, blue.
    pub neons: [Material; 3],
    /// Traffic signs: blue, white, red.
    pub signs: [Material; 3],
}

fn glow(red: f32, green: f32, blue: f32) -> StandardMaterial {
    StandardMaterial {
        emissive: LinearRgba::rgb(red, green, blue),
        reflectance: 0.3,
        ..gloss(Color::BLACK, 0.4)
    }
}

/// A material in another colour and of another roughness.
fn polished(base: &StandardMaterial, color: Color, perceptual_roughness: f32) -> StandardMaterial {
    StandardMaterial {
        perceptual_roughness,
        ..dyed(base, color)
    }
}

/// Cloth or petals, seen from both sides.
fn cloth_of(material: StandardMaterial) -> StandardMaterial {
    both_sides(dielectric(material))
}

/// A pane before an image that shines with a colour.
fn picture(pane: &StandardMaterial, picture: &StandardMaterial, emissive: LinearRgba) -> StandardMaterial {
    StandardMaterial {
        emissive,
        emissive_texture: picture.base_color_texture.clone(),
        ..pane.clone()
    }
}

const PLASTERS: [Color; 5] = [
    Color::srgb(0.95, 0.80, 0.55),
    Color::srgb(0.92, 0.68, 0.58),
    Color::srgb(1.0, 0.97, 0.90),
    Color::srgb(0.72, 0.80, 0.86),
    Color::srgb(0.78, 0.84, 0.70),
];
const BRICKS: [Color; 2] = [Color::srgb(1.0, 0.92, 0.88), Color::srgb(0.78, 0.72, 0.68)];
const STONES: [Color; 2] = [Color::srgb(1.0, 0.97, 0.92), Color::srgb(0.84, 0.85, 0.87)];
const PAINTS: [Color; 6] = [
    Color::srgb(0.10, 0.24, 0.19),
    Color::srgb(0.12, 0.17, 0.30),
    Color::srgb(0.38, 0.08, 0.09),
    Color::srgb(0.88, 0.85, 0.77),
    Color::srgb(0.09, 0.09, 0.10),
    Color::srgb(0.16, 0.37, 0.42),
];
const SHUTTERS: [Color; 4] = [
    Color::srgb(0.32, 0.47, 0.56),
    Color::srgb(0.36, 0.46, 0.33),
    Color::srgb(0.60, 0.56, 0.49),
    Color::srgb(0.45, 0.20, 0.17),
];
const CARS: [Color; 4] = [
    Color::srgb(0.70, 0.05, 0.06),
    Color::srgb(0.05, 0.27, 0.20),
    Color::srgb(0.42, 0.62, 0.76),
    Color::srgb(0.90, 0.84, 0.68),
];
const ENAMELS: [Color; 5] = [
    Color::srgb(0.42, 0.72, 0.66),
    Color::srgb(0.82, 0.14, 0.08),
    Color::srgb(0.93, 0.88, 0.74),
    Color::srgb(0.08, 0.10, 0.13),
    Color::srgb(0.95, 0.66, 0.08),
];
const CLOTHS: [Color; 4] = [
    Color::srgb(0.90, 0.85, 0.72),
    Color::srgb(0.76, 0.13, 0.12),
    Color::srgb(0.16, 0.33, 0.56),
    Color::srgb(0.90, 0.68, 0.20),
];
const PETALS: [Color; 3] = [
    Color::srgb(0.86, 0.12, 0.22),
    Color::srgb(0.93, 0.55, 0.70),
    Color::srgb(0.94, 0.90, 0.84),
];
const LEAVES: [Color; 3] = [
    Color::srgb(1.0, 1.0, 1.0),
    Color::srgb(0.72, 0.86, 0.70),
    Color::srgb(1.0, 0.92, 0.62),
];
/// Words over shops and the paint behind them.
const WORDS: [(&[u8], Vec3); 3] = [
    (b"BOULANGERIE", vec3(0.09, 0.20, 0.17)),
    (b"LIBRAIRIE", vec3(0.24, 0.06, 0.07)),
    (b"TABAC", vec3(0.07, 0.09, 0.16)),
];

/// Textured materials before they are dyed.
struct Bases {
    asphalt: StandardMaterial,
    setts: StandardMaterial,
    slabs: StandardMaterial,
    plaster: StandardMaterial,
    brick: StandardMaterial,
    blocks: StandardMaterial,
    limestone: StandardMaterial,
    cloth: StandardMaterial,
    worn: StandardMaterial,
    wood: StandardMaterial,
    bark: StandardMaterial,
    flakes: StandardMaterial,
    spray: StandardMaterial,
    red_stripes: StandardMaterial,
    green_stripes: StandardMaterial,
    room: StandardMaterial,
    shelves: StandardMaterial,
    glass: StandardMaterial,
}

impl Bases {
    fn bake(scene: &mut SceneBuilder, size: u32) -> Self {
        let half = (size / 2).max(4);
        Self {
            asphalt: scene.textures((2 * size).min(2048), surfaces::asphalt).material(),
            setts: scene.textures(size, surfaces::setts).material(),
            slabs: scene.textures(size, surfaces::slabs).material(),
            plaster: scene.textures(size, patterns::plaster).material(),
            brick: scene.textures(size, patterns::brick).material(),
            blocks: scene.textures(size, patterns::stone_blocks).material(),
            limestone: scene.textures(size, patterns::limestone).material(),
            cloth: scene.textures(size, patterns::cloth).material(),
            worn: scene.textures(half, patterns::worn_metal).material(),
            wood: scene.textures(half, surfaces::wood).material(),
            bark: scene.textures(half, surfaces::bark).material(),
            flakes: scene.textures(half, surfaces::flakes).material(),
            spray: scene.textures(half, surfaces::spray).material(),
            red_stripes: scene
                .textures(half, |uv| surfaces::stripes(uv, vec3(0.62, 0.10, 0.09)))
                .material(),
            green_stripes: scene
                .textures(half, |uv| surfaces::stripes(uv, vec3(0.10, 0.34, 0.24)))
                .material(),
            room: scene.textures(half, surfaces::room).material(),
            shelves: scene.textures(half, surfaces::shelves).material(),
            glass: StandardMaterial {
                reflectance: 0.6,
                ..dielectric(dyed(
                    &scene.textures(half, surfaces::glass).material(),
                    Color::srgb(0.10, 0.12, 0.13),
                ))
            },
        }
    }
}

/// A board with a word.
fn board(scene: &mut SceneBuilder, size: u32, word: &[u8], paint: Vec3) -> StandardMaterial {
    let half = (size / 2).max(4);
    let board = scene.textures(half, |uv| surfaces::lettering(uv, word, paint));
    board.material()
}

impl Materials {
    /// Bakes the textures, `size` texels wide, and makes the materials.
    pub fn new(scene: &mut SceneBuilder, size: u32) -> Self {
        let base = Bases::bake(scene, size);
        let boards = WORDS.map(|(word, paint)| {
            let board = board(scene, size, word, paint);
            scene.material(board)
        });
        let menu = board(scene, size, b"MENU", Vec3::splat(0.06));
        // Only finished materials from here on.
        let mut add = |material| scene.material(material);
        let srgb = Color::srgb;
        let walls = PLASTERS.map(|color| dyed(&base.plaster, color)).into_iter();
        let walls = walls.chain(BRICKS.map(|color| dyed(&base.brick, color)));
        let walls = walls.chain(STONES.map(|color| dyed(&base.blocks, color)));
        let walls = walls.map(&mut add).collect();
        let trims = [srgb(1.0, 0.98, 0.94), srgb(0.74, 0.75, 0.76)];
        let clay = [srgb(0.80, 0.42, 0.28), srgb(0.62, 0.36, 0.27)];
        Self {
            asphalt: add(base.asphalt),
            setts: add(base.setts),
            slabs: add(base.slabs),
            granite: add(polished(&base.limestone, srgb(0.62, 0.63, 0.66), 0.62)),
            marking: add(gloss(srgb(0.74, 0.74, 0.71), 0.24)),
            walls,
            trims: trims.map(|color| add(dyed(&base.limestone, color))),
            woodwork: PAINTS.map(|color| add(dyed(&base.wood, color))),
            shutters: SHUTTERS.map(|color| add(dyed(&base.wood, color))),
            panes: [srgb(0.10, 0.12, 0.13), srgb(0.16, 0.17, 0.18)].map(|color| add(dyed(&base.glass, color))),
            lit_panes: [(2.3, 1.5, 0.75), (1.5, 1.1, 0.72), (0.8, 0.52, 0.30)]
                .map(|(r, g, b)| add(picture(&base.glass, &base.room, LinearRgba::rgb(r, g, b)))),
            shop_pane: add(dyed(&base.glass, srgb(0.07, 0.08, 0.08))),
            lit_shop_panes: [(2.2, 1.6, 0.95), (1.7, 1.55, 1.3), (2.4, 1.35, 0.6)]
                .map(|(r, g, b)| add(picture(&base.glass, &base.shelves, LinearRgba::rgb(r, g, b)))),
            boards,
            menu: add(menu),
            awnings: [
                base.red_stripes,
                base.green_stripes,
                dyed(&base.cloth, srgb(0.12, 0.17, 0.32)),
            ]
            .map(|cloth| add(cloth_of(cloth))),
            cloths: CLOTHS.map(|color| add(cloth_of(dyed(&base.cloth, color)))),
            tiles: clay.map(|color| add(polished(&base.limestone, color, 0.7))),
            slate: add(polished(&base.limestone, srgb(0.29, 0.32, 0.37), 0.45)),
            zinc: add(dyed(&base.worn, srgb(0.62, 0.65, 0.68))),
            brick: add(dyed(&base.brick, srgb(0.86, 0.80, 0.76))),
            terracotta: add(gloss(srgb(0.60, 0.32, 0.21), 0.66)),
            iron: add(gloss(srgb(0.07, 0.08, 0.08), 0.34)),
            cast_iron: add(dyed(&base.worn, srgb(0.34, 0.33, 0.32))),
            chrome: add(metal(srgb(0.93, 0.93, 0.94), 0.06)),
            steel: add(metal(srgb(0.72, 0.73, 0.75), 0.24)),
            brass: add(metal(srgb(0.92, 0.75, 0.42), 0.18)),
            bark: add(base.bark),
            leaves: LEAVES.map(|color| add(props::leaf_material(dyed(&base.spray, color)))),
            petals: PETALS.map(|color| add(cloth_of(gloss(color, 0.55)))),
            soil: add(gloss(srgb(0.15, 0.11, 0.08), 0.85)),
            cars: CARS.map(|color| add(dyed(&base.flakes, color))),
            enamels: ENAMELS.map(|color| add(gloss(color, 0.10))),
            car_glass: add(gloss(srgb(0.04, 0.05, 0.05), 0.02)),
            rubber: add(gloss(srgb(0.06, 0.06, 0.06), 0.62)),
            leather: add(gloss(srgb(0.28, 0.16, 0.10), 0.36)),
            red_glass: add(StandardMaterial {
                emissive: LinearRgba::rgb(0.5, 0.02, 0.01),
                ..gloss(srgb(0.45, 0.02, 0.02), 0.05)
            }),
            marble: add(gloss(srgb(0.80, 0.78, 0.74), 0.09)),
            wicker: add(dyed(&base.cloth, srgb(0.78, 0.58, 0.34))),
            oak: add(dyed(&base.wood, srgb(0.50, 0.31, 0.17))),
            porcelain: add(gloss(srgb(0.90, 0.89, 0.86), 0.07)),
            bottles: [(0.03, 0.13, 0.06), (0.20, 0.08, 0.02), (0.10, 0.02, 0.04)]
                .map(|(r, g, b)| add(gloss(srgb(r, g, b), 0.03))),
            clear_glass: add(gloss(srgb(0.46, 0.50, 0.51), 0.02)),
            fruits: [(0.74, 0.10, 0.08), (0.92, 0.48, 0.06), (0.52, 0.68, 0.16)]
                .map(|(r, g, b)| add(gloss(srgb(r, g, b), 0.30))),
            bulbs: [glow(8.5, 5.2, 2.2), glow(6.5, 2.6, 1.0)].map(&mut add),
            lamp: add(glow(8.0, 5.6, 3.0)),
            neons: [glow(7.5, 0.7, 0.45), glow(0.5, 6.0, 1.4), glow(0.5, 1.6, 7.5)].map(&mut add),
            signs: [(0.03, 0.16, 0.48), (0.88, 0.88, 0.87), (0.70, 0.04, 0.05)]
                .map(|(r, g, b)| add(gloss(srgb(r, g, b), 0.22))),
        }
    }
}
