//! Why photometric matching needs help (figure 3.2 of the thesis): what it costs to match a left pixel
//! along its line in the right image, where the truth lies, and how often the cheapest place is the true
//! one.
//!
//! [`cost`] has the costs of a line, [`discriminator`] what a trained discriminator says of it,
//! [`survey`](mod@survey) goes over a test set, [`draw`] makes the pictures. No depth model takes part.

pub mod cost;
pub mod discriminator;
pub mod draw;
pub mod survey;

use std::path::Path;

use strat_store::{
    files,
    set::{PreparedSet, Sample},
};

use self::{
    discriminator::{Discriminator, DiscriminatorError},
    survey::{Survey, View},
};
use crate::{
    evaluate::SampleError,
    figures::{FigureError, write_sheets},
};

/// The table of how often the cheapest place is the true one.
pub const TABLE: &str = "matching.csv";

/// Where by texture pixels are chosen, as shares of all pixels with truth.
const SHARES: [f64; 4] = [0.05, 0.35, 0.65, 0.95];

/// Why there is no figure 3.2.
#[derive(Debug, thiserror::Error)]
pub enum MatchingError {
    /// A table cannot be written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// A figure cannot be written.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// An image cannot be used.
    #[error(transparent)]
    Sample(#[from] SampleError),
    /// The discriminator cannot be used.
    #[error(transparent)]
    Discriminator(#[from] DiscriminatorError),
    /// The table of matching costs cannot be formed.
    #[error(transparent)]
    Csv(#[from] strat_metrics::CsvError),
    /// Nothing to match in an image.
    #[error(
        "image {image} has no right view or no ground truth from a camera's position, so there is nothing \
         to match; sets of `prep kitti`, `prep eigen` and `prep synth` have both"
    )]
    NoMatching {
        /// The image.
        image: String,
    },
    /// A pixel without truth.
    #[error(
        "image {image} ({width}x{height}) has no true disparity within 8 pixels of ({x}, {y}) that a \
         search could find"
    )]
    NoTruthAt {
        /// The image.
        image: String,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
}

/// What was drawn and found.
pub struct Matching {
    /// Names of the figures.
    pub written: Vec<String>,
    /// How often the cheapest place is the true one.
    pub survey: Survey,
}

/// What figure 3.2 is made of.
pub struct Matcher<'a> {
    /// The prepared set.
    pub set: &'a PreparedSet,
    /// The samples that are searched.
    pub samples: &'a [Sample],
    /// The sample that is drawn.
    pub image: &'a Sample,
    /// Pixels of it that are drawn, in its own size; none for some of every texture.
    pub pixels: &'a [(usize, usize)],
    /// Pixels that are searched in each sample; none for as many as are usual.
    pub per_image: Option<usize>,
    /// Threads.
    pub pool: &'a rayon::ThreadPool,
    /// No progress.
    pub quiet: bool,
}

impl Matcher<'_> {
    /// Draws figure 3.2 of the image and goes over all samples, with what a discriminator says of the
    /// prepared images where there is one.
    ///
    /// # Errors
    /// The image has no right view or no ground truth, the discriminator does not run, or a figure cannot be
    /// written.
    pub fn write(
        &self,
        out: &Path,
        mut judge: Option<&mut Discriminator>,
    ) -> Result<Matching, MatchingError> {
        let Self { set, image, .. } = *self;
        let size = judge.as_deref().map(Discriminator::image_size);
        let view = View::open(set, image, size)?;
        let Some(view) = view.filter(|view| !view.truths.is_empty()) else {
            return Err(MatchingError::NoMatching {
                image: image.id.clone(),
            });
        };
        let mut chosen = Vec::new();
        for &(x, y) in self.pixels {
            chosen.push(draw::nearest(&view, (x, y)).ok_or_else(|| {
                let (width, height) = view.pair.size();
                MatchingError::NoTruthAt {
                    image: image.id.clone(),
                    x,
                    y,
                    width,
                    height,
                }
            })?);
        }
        if chosen.is_empty() {
            chosen = draw::by_texture(&view, &SHARES);
        }
        let mut lines = Vec::new();
        for one in chosen {
            let line = view.judged_line(one.at, judge.as_deref_mut())?;
            lines.push((one, line));
        }
        let window = judge.as_deref().map(Discriminator::window);
        let costs = draw::costs(&image.id, &view, &lines, window);
        let mut written = write_sheets(out, "fig_3_2", &[costs])?;
        let places = draw::places(&image.id, &view, &lines);
        written.extend(write_sheets(out, "fig_3_2_places", &[places])?);
        let usual = if judge.is_some() {
            survey::JUDGED_PIXELS
        } else {
            survey::PIXELS
        };
        let per_image = self.per_image.unwrap_or(usual);
        let survey = survey::survey(set, self.samples, judge, per_image, self.pool, self.quiet);
        for (cost, svg) in draw::found(&survey) {
            written.extend(write_sheets(out, &format!("fig_3_2_found_{cost}"), &[svg])?);
        }
        files::write_atomic(&out.join(TABLE), &survey.csv()?)?;
        Ok(Matching { written, survey })
    }
}
