//! Random draws that depend on what they are for and on nothing else.
//!
//! Every draw of a training run comes from a ChaCha stream whose key is the hash of the
//! run's seed, the purpose and two counters (epoch and sample, or step and pass). No
//! generator is carried from one step to the next: the random state of a run is its seed
//! and its step number, so a resumed run draws what the uninterrupted one would have
//! drawn, on any number of threads.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream of draws is for; streams of different purposes are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Initial weights of the generator.
    Generator,
    /// Initial weights of the discriminator.
    Discriminator,
    /// Order of the training pairs in an epoch; counters: epoch, 0.
    Order,
    /// Augmentation of one pair; counters: epoch, index of the pair in the set.
    Augmentation,
    /// Baseline fraction of the "random" variant; counters: step, 0.
    Baseline,
    /// Patch offsets and colour factors of the discriminator's input; counters: step, pass.
    Patches,
    /// Dropout masks of the discriminator; counters: step, pass.
    Dropout,
}

impl Purpose {
    fn name(self) -> &'static str {
        match self {
            Self::Generator => "generator",
            Self::Discriminator => "discriminator",
            Self::Order => "order",
            Self::Augmentation => "augmentation",
            Self::Baseline => "baseline",
            Self::Patches => "patches",
            Self::Dropout => "dropout",
        }
    }
}

/// A stream of uniform draws, equal on every platform.
#[derive(Clone, Debug)]
pub struct Draws(ChaCha8Rng);

impl Draws {
    /// The stream of `purpose` at the counters `(a, b)` for a run with this seed.
    #[must_use]
    pub fn new(seed: u64, purpose: Purpose, a: u64, b: u64) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"strat-train ");
        hasher.update(purpose.name().as_bytes());
        for value in [seed, a, b] {
            hasher.update(&value.to_le_bytes());
        }
        Self(ChaCha8Rng::from_seed(*hasher.finalize().as_bytes()))
    }

    /// The underlying generator, for draws that are defined elsewhere.
    pub fn generator(&mut self) -> &mut ChaCha8Rng {
        &mut self.0
    }

    /// A whole number over its full range, e.g. as the seed of another generator.
    pub fn integer(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number in `[0, 1)` with 24 random bits.
    pub fn unit(&mut self) -> f32 {
        // 24 bits fill the mantissa of an f32 exactly: no rounding, no value of 1.
        (self.0.next_u32() >> 8) as f32 / 16_777_216.0
    }

    /// A number between the ends of a range; rounding may give the upper end itself.
    pub fn within(&mut self, range: [f32; 2]) -> f32 {
        range[0] + (range[1] - range[0]) * self.unit()
    }

    /// True with this probability.
    pub fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// A whole number in `0..count`; 0 when `count` is 0.
    pub fn below(&mut self, count: usize) -> usize {
        // The product's high half is uniform up to a bias of count / 2^64.
        ((u128::from(self.0.next_u64()) * count as u128) >> 64) as usize
    }

    /// A random order of `0..count` (Fisher-Yates).
    pub fn permutation(&mut self, count: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..count).collect();
        for last in (1..count).rev() {
            order.swap(last, self.below(last + 1));
        }
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_key_same_draws_and_any_other_key_others() {
        let take = |seed, purpose, a, b| {
            let mut draws = Draws::new(seed, purpose, a, b);
            [draws.integer(), draws.integer()]
        };
        let base = take(1, Purpose::Order, 2, 3);
        assert_eq!(base, take(1, Purpose::Order, 2, 3));
        for other in [
            take(2, Purpose::Order, 2, 3),
            take(1, Purpose::Patches, 2, 3),
            take(1, Purpose::Order, 3, 3),
            take(1, Purpose::Order, 2, 4),
            take(1, Purpose::Order, 3, 2),
        ] {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn draws_stay_in_range_and_fill_it() {
        let mut draws = Draws::new(7, Purpose::Augmentation, 0, 0);
        let values: Vec<f32> = (0..4000).map(|_| draws.within([0.5, 2.0])).collect();
        assert!(values.iter().all(|v| (0.5..=2.0).contains(v)));
        let mean = values.iter().sum::<f32>() / 4000.0;
        assert!((mean - 1.25).abs() < 0.03, "mean {mean}");
        assert!(values.iter().any(|v| *v < 0.51) && values.iter().any(|v| *v > 1.99));
        let heads = (0..4000).filter(|_| draws.chance(0.25)).count();
        assert!((900..1100).contains(&heads), "{heads}");
    }

    #[test]
    fn permutation_holds_every_index_once() {
        let mut draws = Draws::new(7, Purpose::Order, 0, 0);
        let mut order = draws.permutation(100);
        assert_ne!(order, (0..100).collect::<Vec<_>>());
        order.sort_unstable();
        assert_eq!(order, (0..100).collect::<Vec<_>>());
        assert_eq!(draws.permutation(0), Vec::<usize>::new());
        assert_eq!(draws.below(0), 0);
    }
}
