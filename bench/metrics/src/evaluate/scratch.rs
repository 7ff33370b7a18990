//! What protocols work out alike at the pixels of one image.
//!
//! Protocols that differ in a cap or a crop compare the same two depths at most pixels. What one has found
//! there, two logarithms and three quotients, the next takes over wherever it meets the same two numbers:
//! no digit depends on it. Not here: which pixels these are.

use crate::metrics::Terms;

/// What the protocol before has found at the pixels of an image.
///
/// One for each image, handed to [`evaluate_measured`](super::evaluate_measured) protocol by protocol.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// Places in the list of measured pixels, ascending.
    places: Vec<u32>,
    terms: Vec<Terms>,
}

impl Scratch {
    /// What the metrics sum up at pixels, given by place in ascending order with true and predicted
    /// depth in metres.
    pub(super) fn terms(
        &mut self,
        pixels: impl ExactSizeIterator<Item = (u32, f64, f64)>,
    ) -> &[Terms] {
        let before = std::mem::take(self);
        let mut known = before.places.iter().zip(&before.terms).peekable();
        self.places.reserve_exact(pixels.len());
        self.terms.reserve_exact(pixels.len());
        for (place, truth_m, predicted_m) in pixels {
            while known.next_if(|(known, _)| **known < place).is_some() {}
            let terms = match known.peek() {
                Some((known, terms)) if **known == place => terms.or_of(truth_m, predicted_m),
                _ => Terms::new(truth_m, predicted_m),
            };
            self.places.push(place);
            self.terms.push(terms);
        }
        &self.terms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever came before, a pixel has the terms of its own two depths.
    #[test]
    fn what_was_found_before_changes_nothing() {
        let mut scratch = Scratch::default();
        for pixels in [
            vec![(1, 10.0, 11.0), (4, 20.0, 90.0), (5, 7.0, 7.5)],
            vec![
                (0, 3.0, 3.1),
                (4, 20.0, 50.0),
                (5, 7.0, 7.5),
                (9, 60.0, 50.0),
            ],
            vec![(4, 21.0, 50.0)],
            vec![],
            vec![(4, 21.0, 50.0)],
        ] {
            let fresh: Vec<Terms> = pixels.iter().map(|&(_, g, p)| Terms::new(g, p)).collect();
            assert_eq!(scratch.terms(pixels.into_iter()), fresh);
        }
    }
}
