//! Which methods a leaderboard can rank, and where (PROTOCOL 12).
//!
//! Methods that were measured on the same images are put into groups: the best mean, and all that a
//! paired test does not tell apart from it, share a rank; the best of the rest begins the next group.
//! The test is [`compare`](crate::compare)'s sign-flip test of whole recordings with the same drawn
//! patterns, Holm's correction runs over the methods that are held against one best. Not here: which
//! methods may take part.

use rand::Rng;
use serde::Serialize;

use crate::compare::{EXACT_UP_TO, TestOptions, holm, smallest_p};

/// Differences with a p value after Holm below this are told apart.
pub const LEVEL: f64 = 0.05;

/// The sign patterns of [`sign_flip`](crate::compare::sign_flip) for a number of recordings, drawn
/// once for many tests. Sums run byte by byte through tables, so p values are the same and a test
/// costs a few additions a pattern.
#[derive(Clone, Debug)]
pub struct SignFlips {
    recordings: usize,
    /// Words of 64 signs each, pattern after pattern.
    patterns: Vec<u64>,
    is_exact: bool,
}

impl SignFlips {
    /// Patterns for so many recordings; `None` below two.
    #[must_use]
    pub fn new(recordings: usize, options: &TestOptions) -> Option<Self> {
        if recordings < 2 {
            return None;
        }
        let is_exact = recordings <= EXACT_UP_TO;
        let patterns = if is_exact {
            (0..1_u64 << recordings).collect()
        } else {
            let mut random = options.random();
            let words = options.permutations as usize * recordings.div_ceil(64);
            (0..words).map(|_| random.next_u64()).collect()
        };
        Some(Self {
            recordings,
            patterns,
            is_exact,
        })
    }

    /// Two-sided p of the hypothesis that the sign of each difference is a coin's.
    ///
    /// # Panics
    /// If there is not one difference for each recording.
    #[must_use]
    pub fn p(&self, differences: &[f64]) -> f64 {
        assert_eq!(differences.len(), self.recordings, "a difference for each");
        let observed = differences.iter().sum::<f64>().abs();
        let slack = 1e-12 * differences.iter().map(|value| value.abs()).sum::<f64>();
        let tables: Vec<[f64; 256]> = differences.chunks(8).map(table).collect();
        let words = self.recordings.div_ceil(64);
        let hits = self.patterns.chunks_exact(words).filter(|pattern| {
            let mut sum = 0.0;
            for (word, tables) in pattern.iter().zip(tables.chunks(8)) {
                for (byte, table) in tables.iter().enumerate() {
                    sum += table[(word >> (8 * byte) & 0xff) as usize];
                }
            }
            sum.abs() >= observed - slack
        });
        let hits = hits.count() as f64;
        let patterns = (self.patterns.len() / words) as f64;
        match self.is_exact {
            true => hits / patterns,
            false => (hits + 1.0) / (patterns + 1.0),
        }
    }
}

/// Sums of up to eight differences under each pattern of their signs.
fn table(differences: &[f64]) -> [f64; 256] {
    std::array::from_fn(|pattern| {
        let signed = differences.iter().enumerate();
        signed
            .map(|(bit, value)| {
                if pattern >> bit & 1 == 1 {
                    -value
                } else {
                    *value
                }
            })
            .sum()
    })
}

/// A method as far as a rank depends on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Mean of the metric over the images.
    pub mean: f64,
    /// Sums of the metric over the images of each recording, recordings in the same order for all.
    pub totals: Vec<f64>,
}

/// Where a method stands under one metric.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Place {
    /// One more than the methods in better groups; `None` where nothing can be said.
    pub rank: Option<usize>,
    /// p of the difference to the best of all; `None` for the best itself.
    pub p: Option<f64>,
    /// The same after Holm, over all that were held against the best.
    pub p_holm: Option<f64>,
}

/// Why there are no ranks.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error, Serialize)]
pub enum NoRank {
    /// Nothing to rank against.
    #[error("it takes at least two complete methods")]
    Alone,
    /// No test could tell methods apart.
    #[error(
        "{recordings} recordings cannot tell {methods} methods apart: after Holm, no p value can be \
         below {smallest:.2}"
    )]
    TooFewRecordings {
        /// Recordings that the images are of.
        recordings: usize,
        /// Methods.
        methods: usize,
        /// The smallest p value after Holm.
        smallest: f64,
    },
}

/// Places of methods that were measured on the same images, in the order given, and why there are no
/// ranks where nothing can be said; p values stand there all the same, if there are any.
pub fn rank(
    candidates: &[Candidate],
    lower_is_better: bool,
    options: &TestOptions,
) -> (Vec<Place>, Option<NoRank>) {
    let mut places = vec![Place::default(); candidates.len()];
    let mut rest: Vec<usize> = (0..candidates.len()).collect();
    rest.sort_by(|a, b| {
        let order = candidates[*a].mean.total_cmp(&candidates[*b].mean);
        if lower_is_better {
            order
        } else {
            order.reverse()
        }
    });
    if candidates.len() < 2 {
        return (places, Some(NoRank::Alone));
    }
    let recordings = candidates[0].totals.len();
    let others = (candidates.len() - 1) as f64;
    // Differences of recordings that are alike decide nothing, so the real bound may be higher.
    let lowest = smallest_p(&vec![1.0; recordings], options.permutations);
    let smallest = lowest.map_or(1.0, |p| (p * others).min(1.0));
    let flips = SignFlips::new(recordings, options);
    let no_rank = (smallest >= LEVEL).then_some(NoRank::TooFewRecordings {
        recordings,
        methods: candidates.len(),
        smallest,
    });
    let Some(flips) = flips else {
        return (places, no_rank);
    };
    let mut better = 0;
    while let Some((best, others)) = rest.split_first() {
        let differences = |index: usize| -> Vec<f64> {
            let pairs = candidates[index]
                .totals
                .iter()
                .zip(&candidates[*best].totals);
            pairs.map(|(a, b)| a - b).collect()
        };
        let p: Vec<f64> = others
            .iter()
            .map(|&index| flips.p(&differences(index)))
            .collect();
        let adjusted = holm(&p);
        if better == 0 {
            for ((&index, p), p_holm) in others.iter().zip(&p).zip(&adjusted) {
                places[index].p = Some(*p);
                places[index].p_holm = Some(*p_holm);
            }
            if no_rank.is_some() {
                return (places, no_rank);
            }
        }
        places[*best].rank = Some(better + 1);
        let mut next = Vec::new();
        for (&index, p) in others.iter().zip(adjusted) {
            if p < LEVEL {
                next.push(index);
            } else {
                places[index].rank = Some(better + 1);
            }
        }
        better += rest.len() - next.len();
        rest = next;
    }
    (places, None)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::compare::sign_flip;

    /// The tables give what the test itself gives, counted and drawn, within one word and beyond.
    #[test]
    fn p_values_are_those_of_the_test() {
        let options = TestOptions {
            permutations: 500,
            seed: 3,
        };
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for recordings in [2, 3, 8, 9, 16, 17, 28, 64, 65, 130] {
            let flips = SignFlips::new(recordings, &options).unwrap();
            for shift in [0.0, 0.2, 2.0] {
                let differences: Vec<f64> = (0..recordings)
                    .map(|_| random.random_range(-1.0..1.0) + shift)
                    .collect();
                assert_eq!(
                    Some(flips.p(&differences)),
                    sign_flip(&differences, options.permutations, options.seed),
                    "{recordings}"
                );
            }
            assert_eq!(flips.p(&vec![0.0; recordings]), 1.0);
        }
        assert!(SignFlips::new(1, &options).is_none());
    }

    /// Totals over drives of one image each, around a mean, with noise that methods share or not.
    fn method(mean: f64, own: f64, seed: u64) -> Candidate {
        let mut shared = ChaCha8Rng::seed_from_u64(0);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let totals: Vec<f64> = (0..28)
            .map(|_| mean + shared.random_range(-0.05..0.05) + own * random.random_range(-1.0..1.0))
            .collect();
        Candidate {
            mean: totals.iter().sum::<f64>() / 28.0,
            totals,
        }
    }

    #[test]
    fn what_is_not_told_apart_shares_a_rank() {
        let methods = [
            method(0.20, 0.001, 1),
            method(0.10, 0.02, 2),
            method(0.101, 0.02, 3),
            method(0.15, 0.001, 4),
            method(0.150_01, 0.02, 5),
        ];
        let (places, none) = rank(&methods, true, &TestOptions::default());
        let ranks: Vec<usize> = places.iter().map(|place| place.rank.unwrap()).collect();
        assert_eq!((ranks, none), (vec![5, 1, 1, 3, 3], None));
        assert!(
            places[1].p.is_none() || places[2].p.is_none(),
            "the best has none"
        );
        assert!(places[0].p_holm.unwrap() < 0.01);
        // An accuracy is ranked the other way round.
        let (places, _) = rank(&methods, false, &TestOptions::default());
        assert_eq!(places[0].rank, Some(1));
        // The order in which methods come must not matter.
        let mut turned = methods.to_vec();
        turned.reverse();
        let (turned, _) = rank(&turned, true, &TestOptions::default());
        let turned: Vec<usize> = turned
            .iter()
            .rev()
            .map(|place| place.rank.unwrap())
            .collect();
        assert_eq!(turned, [5, 1, 1, 3, 3]);
    }

    #[test]
    fn no_rank_where_nothing_can_be_said() {
        let one = [method(0.1, 0.0, 1)];
        assert_eq!(
            rank(&one, true, &TestOptions::default()).1,
            Some(NoRank::Alone)
        );
        // Four drives: the smallest p is 1 / 8.
        let few = [0.1, 0.2, 0.3].map(|mean| Candidate {
            mean,
            totals: vec![mean; 4],
        });
        let (places, none) = rank(&few, true, &TestOptions::default());
        assert!(places.iter().all(|place| place.rank.is_none()));
        assert_eq!(
            none.unwrap().to_string(),
            "4 recordings cannot tell 3 methods apart: after Holm, no p value can be below 0.25"
        );
        assert_eq!((places[0].p, places[1].p), (None, Some(0.125)));
    }
}
