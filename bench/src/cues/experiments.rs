//! Which composites the experiments of chapter 4 consist of (PROTOCOL 5.1 to 5.3, decision D18).
//!
//! Sizes are stated for KITTI's images of 370 to 376 rows and are scaled with the height of
//! images of other sizes. A plan is a list of [`Job`]s and depends on nothing but the
//! backgrounds' sizes, the sprites and the [`Plan`].

use super::{
    composite::{Place, extent},
    error::CueError,
    rows::{Condition, Experiment},
    sprites::{Sprite, SpriteError, View},
};

/// Backgrounds of the thesis' own experiment on relative size.
pub const THESIS_BACKGROUNDS: usize = 5;
/// Height of a KITTI image, to which the sizes below belong.
const NOMINAL_ROWS: f64 = 375.0;
/// Largest and smallest height of a sprite in the size experiment, pixels.
const SIZE_RANGE_PX: [f64; 2] = [220.0, 12.0];
/// Contact row of the size experiment as a share of the image height: in the central third and
/// low enough for the largest sprite.
const SIZE_CONTACT: f64 = 0.64;
/// Factor of the second sprite of fixed size.
const PAIR_FACTOR: f64 = 10.0;
/// Height of the camera above the ground, metres.
pub const CAMERA_HEIGHT_M: f64 = 1.65;
/// Heights of the front sprite in the occlusion experiment: largest, smallest and their number.
const OCCLUSION_RANGE_PX: [f64; 2] = [160.0, 40.0];
const OCCLUSION_SIZES: u32 = 10;
/// The rear sprite's depth over the front one's, and the share of its width that is hidden.
const OCCLUSION_DEPTH_RATIO: f64 = 1.3;
const OCCLUSION_OVERLAP: f64 = 0.4;
/// Places from the bottom row to the horizon.
const HEIGHT_PLACES: u32 = 40;
/// Where the size that follows from the ground falls below this, the run ends, pixels.
const HEIGHT_SMALLEST_PX: f64 = 12.0;
/// Depth whose size the run of fixed size has, metres.
const HEIGHT_FIXED_DEPTH_M: f64 = 20.0;

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Relative size.
    pub size: bool,
    /// Occlusion and luminance contrast.
    pub occlusion: bool,
    /// Height in the visual field.
    pub height: bool,
    /// Number of sizes k = 1, 2, ... of the size experiment.
    pub scales: u32,
}

/// The sizes and the camera of one background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row of the horizon.
    pub horizon_row: f64,
    /// Focal length where it is known.
    pub focal_px: Option<f64>,
}

impl Ground {
    /// What a size given for KITTI is here.
    fn scaled(&self, px: f64) -> f64 {
        let ratio = f64::from(self.height) / NOMINAL_ROWS;
        // KITTI's five sizes take the figures as they are.
        if (0.95..=1.05).contains(&ratio) {
            px
        } else {
            px * ratio
        }
    }

    fn bottom_row(&self) -> f64 {
        f64::from(self.height) - 1.0
    }

    fn middle(&self) -> f64 {
        0.5 * (f64::from(self.width) - 1.0)
    }
}

/// The sprites by the part they play; numbers index the list they were chosen from.
#[derive(Clone, Debug)]
pub struct Cast {
    /// All sprites, and behind them those of another luminance.
    pub sprites: Vec<Sprite>,
    /// Those of the size experiment.
    sized: Vec<usize>,
    /// The one of the height experiment, and the familiar pair.
    familiar: usize,
    /// The unfamiliar pair.
    unfamiliar: usize,
    /// The same two with another luminance.
    contrasted: [usize; 2],
}

impl Cast {
    /// Chooses among sprites: those seen from `view` or from anywhere, one of each name.
    ///
    /// `car` and `crate` play the parts of the thesis; without them the first familiar and the
    /// first unfamiliar sprite do.
    ///
    /// # Errors
    /// There is no familiar or no unfamiliar sprite, or one has no room for another luminance.
    pub fn choose(
        all: Vec<Sprite>,
        view: View,
        source: &std::path::Path,
    ) -> Result<Self, SpriteError> {
        let mut sprites: Vec<Sprite> = Vec::new();
        for sprite in all {
            let seen = sprite.view.is_none_or(|own| own == view);
            if seen && sprites.iter().all(|other| other.name != sprite.name) {
                sprites.push(sprite);
            }
        }
        let find = |name: &str, familiar: bool, what| {
            let named = sprites
                .iter()
                .position(|sprite| sprite.name == name && sprite.familiar == familiar);
            named
                .or_else(|| {
                    sprites
                        .iter()
                        .position(|sprite| sprite.familiar == familiar)
                })
                .ok_or(SpriteError::NoneOf {
                    path: source.to_path_buf(),
                    what,
                })
        };
        let familiar = find("car", true, "familiar sprite of this view (familiar: true)")?;
        let unfamiliar = find(
            "crate",
            false,
            "unfamiliar sprite of this view (familiar: false)",
        )?;
        let sized = (0..sprites.len()).collect();
        let first = sprites.len();
        for index in [familiar, unfamiliar] {
            sprites.push(sprites[index].with_other_luminance()?);
        }
        Ok(Self {
            sprites,
            sized,
            familiar,
            unfamiliar,
            contrasted: [first, first + 1],
        })
    }
}

/// A sprite of a composite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paste {
    /// Index into [`Cast::sprites`].
    pub sprite: usize,
    /// Where it stands.
    pub place: Place,
}

/// One or two composites that are measured together.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Which experiment.
    pub experiment: Experiment,
    /// Index of the background.
    pub background: usize,
    /// 1-based step of the series.
    pub step: u32,
    /// One of the composites of the thesis.
    pub thesis: bool,
    /// Depth that the varied cue implies.
    pub ideal_depth_m: Option<f64>,
    /// The composites; the sprite that is measured comes last, on top of the others.
    pub composites: Vec<(Condition, Vec<Paste>)>,
}

/// All jobs of a plan, in the order of their rows.
///
/// # Errors
/// A sprite does not fit into a background.
pub fn jobs(plan: Plan, cast: &Cast, grounds: &[Ground]) -> Result<Vec<Job>, CueError> {
    let mut jobs = Vec::new();
    if plan.size {
        for &sprite in &cast.sized {
            for (background, ground) in grounds.iter().enumerate() {
                size_jobs(plan.scales, cast, sprite, background, ground, &mut jobs);
            }
        }
    }
    if plan.occlusion {
        for (part, sprite) in [cast.familiar, cast.unfamiliar].into_iter().enumerate() {
            let lit = cast.contrasted[part];
            for (background, ground) in grounds.iter().enumerate() {
                let pair = [sprite, lit];
                occlusion_jobs(cast, pair, part == 0, background, ground, &mut jobs);
            }
        }
    }
    if plan.height {
        for (background, ground) in grounds.iter().enumerate() {
            height_jobs(cast, background, ground, &mut jobs);
        }
    }
    for job in &jobs {
        let ground = &grounds[job.background];
        for paste in job.composites.iter().flat_map(|(_, pastes)| pastes) {
            let sprite = &cast.sprites[paste.sprite];
            let [left, top, right, _] = extent(sprite, paste.place);
            // Whole, but for what a bottom row may hide of its wheels.
            if left < 0.0 || top < 0.0 || right > f64::from(ground.width) {
                return Err(CueError::SpriteTooLarge {
                    sprite: sprite.name.clone(),
                    width: (right - left).round() as u32,
                    height: paste.place.height_px.round() as u32,
                    image_width: ground.width,
                    image_height: ground.height,
                });
            }
        }
    }
    Ok(jobs)
}

/// PROTOCOL 5.1: height = h_max / (1 + (k - 1) (h_max / h_min - 1) / (n - 1)), so that the ideal
/// depth grows linearly with k.
fn height_of_factor(ground: &Ground, factor: f64, scales: u32) -> f64 {
    let [largest, smallest] = SIZE_RANGE_PX.map(|px| ground.scaled(px));
    let steps = f64::from(scales.max(2) - 1);
    largest / (1.0 + (factor - 1.0) * (largest / smallest - 1.0) / steps)
}

fn size_jobs(
    scales: u32,
    cast: &Cast,
    sprite: usize,
    background: usize,
    ground: &Ground,
    jobs: &mut Vec<Job>,
) {
    let shown = &cast.sprites[sprite];
    let contact_row = (SIZE_CONTACT * f64::from(ground.height)).round();
    let at = |column: f64, height_px: f64| Paste {
        sprite,
        place: Place {
            column,
            contact_row,
            height_px,
        },
    };
    let thesis = background < THESIS_BACKGROUNDS && matches!(&*shown.name, "car" | "pedestrian");
    // Beside the largest one, so that they never touch.
    let fixed_px = height_of_factor(ground, PAIR_FACTOR, 50);
    let largest_px = height_of_factor(ground, 1.0, scales);
    let second = at(
        ground.middle() + 0.5 * shown.aspect() * (largest_px + fixed_px) + ground.scaled(12.0),
        fixed_px,
    );
    for step in 1..=scales {
        let height_px = height_of_factor(ground, f64::from(step), scales);
        let first = at(ground.middle(), height_px);
        let ideal_depth_m = ground
            .focal_px
            .map(|focal_px| focal_px * shown.height_m / height_px);
        let mut add = |experiment, condition, pastes, thesis| {
            jobs.push(Job {
                experiment,
                background,
                step,
                thesis,
                ideal_depth_m,
                composites: vec![(condition, pastes)],
            });
        };
        add(Experiment::Size, Condition::Single, vec![first], thesis);
        if sprite == cast.unfamiliar {
            let pastes = vec![second, first];
            add(Experiment::SizePair, Condition::Pair, pastes, false);
        }
    }
}

/// PROTOCOL 5.2; the rear sprite stands behind the front one on the same ground.
fn occlusion_jobs(
    cast: &Cast,
    [sprite, lit]: [usize; 2],
    familiar: bool,
    background: usize,
    ground: &Ground,
    jobs: &mut Vec<Job>,
) {
    let shown = &cast.sprites[sprite];
    // The ground under a car of that size carries both kinds of sprites.
    let car_m = cast.sprites[cast.familiar].height_m;
    let [largest, smallest] = OCCLUSION_RANGE_PX.map(|px| ground.scaled(px));
    for step in 1..=OCCLUSION_SIZES {
        let share = f64::from(step - 1) / f64::from(OCCLUSION_SIZES - 1);
        let front_px = largest + (smallest - largest) * share;
        let rear_px = front_px / OCCLUSION_DEPTH_RATIO;
        let below = |height_px: f64| {
            (ground.horizon_row + height_px * CAMERA_HEIGHT_M / car_m).min(ground.bottom_row())
        };
        let (front_width, rear_width) = (front_px * shown.aspect(), rear_px * shown.aspect());
        // Both together stand in the middle.
        let apart = 0.5 * (front_width + rear_width) - OCCLUSION_OVERLAP * rear_width;
        let whole = apart + 0.5 * (front_width + rear_width);
        let front_column = ground.middle() - 0.5 * whole + 0.5 * front_width;
        let rear = Paste {
            sprite,
            place: Place {
                column: front_column + apart,
                contact_row: below(rear_px),
                height_px: rear_px,
            },
        };
        let front = |sprite| Paste {
            sprite,
            place: Place {
                column: front_column,
                contact_row: below(front_px),
                height_px: front_px,
            },
        };
        jobs.push(Job {
            experiment: Experiment::Occlusion,
            background,
            step,
            thesis: familiar,
            ideal_depth_m: ground.focal_px.map(|focal_px| focal_px * car_m / front_px),
            composites: vec![
                (Condition::Same, vec![rear, front(sprite)]),
                (Condition::Contrast, vec![rear, front(lit)]),
            ],
        });
    }
}

/// PROTOCOL 5.3: run A follows the ground, run B keeps one size at the same places.
fn height_jobs(cast: &Cast, background: usize, ground: &Ground, jobs: &mut Vec<Job>) {
    let sprite = cast.familiar;
    let height_m = cast.sprites[sprite].height_m;
    let on_ground =
        |contact_row: f64| height_m * (contact_row - ground.horizon_row) / CAMERA_HEIGHT_M;
    let nearest = ground.bottom_row();
    let farthest =
        ground.horizon_row + ground.scaled(HEIGHT_SMALLEST_PX) * CAMERA_HEIGHT_M / height_m;
    // 721.5 px is KITTI's focal length; where none is known, the same share of the height.
    let focal_px = ground.focal_px.unwrap_or_else(|| ground.scaled(721.5));
    let fixed_px = focal_px * height_m / HEIGHT_FIXED_DEPTH_M;
    for condition in [Condition::SizeChanges, Condition::SizeFixed] {
        for step in 1..=HEIGHT_PLACES {
            let share = f64::from(step - 1) / f64::from(HEIGHT_PLACES - 1);
            let contact_row = nearest + (farthest - nearest) * share;
            let height_px = match condition {
                Condition::SizeFixed => fixed_px,
                _ => on_ground(contact_row),
            };
            let paste = Paste {
                sprite,
                place: Place {
                    column: ground.middle(),
                    contact_row,
                    height_px,
                },
            };
            jobs.push(Job {
                experiment: Experiment::Height,
                background,
                step,
                thesis: true,
                ideal_depth_m: ground.focal_px.map(|focal_px| {
                    focal_px * CAMERA_HEIGHT_M / (contact_row - ground.horizon_row)
                }),
                composites: vec![(condition, vec![paste])],
            });
        }
    }
}
