//! What a rank says, in words.

use maud::{Markup, html};

/// PROTOCOL 12 in short.
pub(super) fn ranking_rules() -> Markup {
    html! {
        h3 { "What a rank says" }
        ul {
            li { "Ranked together are methods with rows for the same images, under the same protocol and the same \
                  data set, known by their digests. Each alignment is a protocol of its own." }
            li { "The best mean, and every method that a paired test does not tell apart from it (sign flips of whole \
                  recordings, p at least 0.05 after Holm), have rank 1. The best of the rest begins the next group; a \
                  rank is one more than the methods in better groups." }
            li { "Listed without a rank: partial submissions, models that name drives of the test, or the other split, as \
                  their training, published numbers (they have no rows), and everything where so few recordings can tell \
                  nothing apart. Models that do not say what they were trained on are ranked, with the words \"training \
                  drives unknown\": these pages cannot know more than the record of the run says." }
            li { "Intervals are 95 % t intervals over recordings: they speak of the choice of test images, not of the spread \
                  between training runs. Two intervals that overlap may still belong to methods that are told apart, \
                  because the test compares image by image." }
        }
    }
}
