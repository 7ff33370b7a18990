//! A few of many, spread evenly.

/// The indices of `count` of `len` things, spread evenly and beginning with the first:
/// `i * len / count`. All of them if `count` is larger.
pub fn evenly(len: usize, count: usize) -> impl ExactSizeIterator<Item = usize> {
    let count = count.min(len);
    (0..count).map(move |index| index * len / count)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_few_are_spread() {
        let spread = |len, count| evenly(len, count).collect::<Vec<_>>();
        assert_eq!(spread(10, 3), [0, 3, 6]);
        assert_eq!(spread(697, 5), [0, 139, 278, 418, 557]);
        assert_eq!(spread(3, 9), [0, 1, 2]);
        assert_eq!(spread(0, 4), []);
        assert_eq!(spread(4, 0), []);
    }

    proptest! {
        #[test]
        fn indices_rise_and_stay_inside(len in 0_usize..2000, count in 0_usize..2000) {
            let chosen: Vec<_> = evenly(len, count).collect();
            prop_assert_eq!(chosen.len(), count.min(len));
            prop_assert!(chosen.is_sorted_by(|a, b| a < b));
            prop_assert!(chosen.iter().all(|index| *index < len));
        }
    }
}
