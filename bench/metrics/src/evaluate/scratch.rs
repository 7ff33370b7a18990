//! What protocols work out alike at the pixels of one image.
//!
//! Protocols that differ in a cap or a crop compare the same two depths at most pixels. What the first has found
//! there, two logarithms and three quotients, the others take over wherever they meet the same numbers: no digit
//! depends on it. Not here: which pixels these are.

use crate::sums::Terms;

/// What the first protocol has found at the pixels of an image.
///
/// One for each image, handed to [`evaluate_measured`](super::evaluate_measured) protocol by protocol.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// Places in the list of measured pixels, ascending.
    places: Vec<u32>,
    terms: Vec<Terms>,
}

impl Scratch {
    /// One that holds nothing is filled by the next protocol, which has at most so many pixels.
    pub(super) fn begin(&mut self, pixels: usize) -> Finder<'_> {
        let is_empty = self.places.is_empty();
        if is_empty {
            self.places.reserve_exact(pixels);
            self.terms.reserve_exact(pixels);
        }
        Finder {
            scratch: self,
            is_filling: is_empty,
            next: 0,
            found: Vec::new(),
        }
    }
}

/// One protocol on its way through the pixels.
pub(super) struct Finder<'a> {
    scratch: &'a mut Scratch,
    is_filling: bool,
    next: usize,
    found: Vec<Terms>,
}

impl Finder<'_> {
    /// What the metrics sum up at each of some pixels, which come after the ones before and are at most
    /// [`AT_A_TIME`](crate::sums::AT_A_TIME): by place, true and predicted depth in metres.
    pub(super) fn terms(
        &mut self,
        pixels: &[u32],
        truth_m: &[f64],
        predicted_m: &[f64],
    ) -> &[Terms] {
        let Scratch { places, terms } = &mut *self.scratch;
        if self.is_filling {
            let first = terms.len();
            places.extend_from_slice(pixels);
            Terms::extend(terms, truth_m, predicted_m);
            return &terms[first..];
        }
        let next = &mut self.next;
        let depths = truth_m.iter().zip(predicted_m);
        // Where nothing is far, whole pieces are those of the first protocol.
        while (places.get(*next).zip(pixels.first())).is_some_and(|(known, first)| known < first) {
            *next += 1;
        }
        let some = *next..*next + pixels.len();
        if places.get(some.clone()) == Some(pixels)
            && let Some(terms) = terms.get(some)
            && (terms.iter().zip(depths.clone())).all(|(terms, (&g, &p))| terms.is_of(g, p))
        {
            *next += pixels.len();
            return terms;
        }
        self.found.clear();
        self.found.extend(
            pixels
                .iter()
                .zip(depths)
                .map(|(place, (&truth_m, &predicted_m))| {
                    while places.get(*next).is_some_and(|known| known < place) {
                        *next += 1;
                    }
                    match (places.get(*next), terms.get(*next)) {
                        (Some(known), Some(terms))
                            if known == place && terms.is_of(truth_m, predicted_m) =>
                        {
                            *terms
                        }
                        _ => Terms::new(truth_m, predicted_m),
                    }
                }),
        );
        &self.found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever came before, a pixel has the terms of its own two depths.
    #[test]
    fn what_was_found_before_changes_nothing() {
        let mut scratch = Scratch::default();
        let cases: [&[(u32, f64, f64)]; 5] = [
            &[],
            &[(1, 10.0, 11.0), (4, 20.0, 90.0), (5, 7.0, 7.5)],
            &[
                (0, 3.0, 3.1),
                (4, 20.0, 50.0),
                (5, 7.0, 7.5),
                (9, 60.0, 50.0),
            ],
            &[(4, 21.0, 50.0)],
            &[(5, 7.0, 7.5)],
        ];
        for pixels in cases {
            let expected: Vec<Terms> = pixels.iter().map(|&(_, g, p)| Terms::new(g, p)).collect();
            let mut finder = scratch.begin(pixels.len());
            let mut found = Vec::new();
            let (some, others) = pixels.split_at(pixels.len() / 2);
            for pixels in [some, others] {
                let places: Vec<u32> = pixels.iter().map(|pixel| pixel.0).collect();
                let (truth_m, predicted_m): (Vec<f64>, Vec<f64>) =
                    pixels.iter().map(|&(_, g, p)| (g, p)).unzip();
                found.extend_from_slice(finder.terms(&places, &truth_m, &predicted_m));
            }
            assert_eq!(found, expected);
        }
        assert_eq!(scratch.places, [1, 4, 5]);
    }
}
