//! What is summed up of the pixels of an image, group by group.
//!
//! Not here: what the sums are ([`crate::sums`]), and which pixels there are.

use crate::metrics::WrongDisparities;
use crate::protocol::{Group, Grouping};
use crate::sums::Tally;

/// What is found of one group of pixels, or of all.
#[derive(Clone, Copy, Default)]
pub(super) struct GroupTally {
    pub(super) sums: Tally,
    pub(super) disparities: WrongDisparities,
    /// Also those that have no prediction.
    pub(super) floored: u64,
}

/// What is found of the groups of a protocol.
pub(super) struct Tallies {
    pub(super) groups: Vec<(Option<Group>, GroupTally)>,
    /// Pixels without a prediction, of any group or none.
    pub(super) unpredicted: usize,
}

impl Tallies {
    pub(super) fn new(grouping: Grouping) -> Self {
        let empty = |group| (group, GroupTally::default());
        let groups = match grouping {
            Grouping::None => vec![empty(None)],
            grouping => grouping
                .groups()
                .iter()
                .copied()
                .map(Some)
                .map(empty)
                .collect(),
        };
        Self {
            groups,
            unpredicted: 0,
        }
    }

    /// Of a group; `None` for pixels that belong to none of the protocol's.
    pub(super) fn of(&mut self, group: Option<Group>) -> Option<&mut GroupTally> {
        let mut groups = self.groups.iter_mut();
        let own = groups.find(|(known, _)| *known == group);
        own.map(|(_, tally)| tally)
    }

    pub(super) fn add_unpredicted(&mut self, group: Option<Group>) {
        self.unpredicted += 1;
        if let Some(own) = self.of(group) {
            own.floored += 1;
        }
    }
}
