//! Names of protocols: a base, and suffixes that change one rule each.
//!
//! Every combination has one canonical spelling, the order of [`Suffix::ALL`]; other orders are
//! read as the same protocol. The name is part of a protocol's digest, so rows that were written
//! under another spelling carry another digest: [`canonical`] translates both.

use std::fmt;

use super::choices::{Alignment, Crop, PostProcessing};
use super::group::Grouping;
use super::registry::named;
use super::rules::Protocol;

/// What may follow the name of a protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Suffix {
    /// `-nocrop`, `-garg`, `-eigencrop`: the same rules with another crop.
    Crop(Crop),
    /// `-pp`: blended with the prediction for the mirrored image.
    Flip,
    /// `-distance`: pixels scored by their true depth.
    Distance,
    /// `-median`, `-affine-disparity` and so on: each prediction aligned with its image's truth.
    Align(Alignment),
}

impl Suffix {
    /// All suffixes in the order in which they stand in a name.
    pub const ALL: [Self; 10] = [
        Self::Crop(Crop::None),
        Self::Crop(Crop::Garg),
        Self::Crop(Crop::Eigen),
        Self::Flip,
        Self::Distance,
        Self::Align(Alignment::Median),
        Self::Align(Alignment::ScaleDepth),
        Self::Align(Alignment::AffineDepth),
        Self::Align(Alignment::ScaleDisparity),
        Self::Align(Alignment::AffineDisparity),
    ];

    /// The suffix of an alignment; `None` for the one that changes nothing.
    #[must_use]
    pub fn of_alignment(alignment: Alignment) -> Option<Self> {
        (alignment != Alignment::None).then_some(Self::Align(alignment))
    }

    /// The suffix with its hyphen.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Crop(Crop::None) => "-nocrop",
            Self::Crop(Crop::Garg) => "-garg",
            Self::Crop(Crop::Eigen) => "-eigencrop",
            // Only a file of the user's own has one.
            Self::Crop(Crop::Pixels { .. }) => "",
            Self::Flip => "-pp",
            Self::Distance => "-distance",
            Self::Align(Alignment::None) => "",
            Self::Align(Alignment::Median) => "-median",
            Self::Align(Alignment::ScaleDepth) => "-scale-depth",
            Self::Align(Alignment::AffineDepth) => "-affine-depth",
            Self::Align(Alignment::ScaleDisparity) => "-scale-disparity",
            Self::Align(Alignment::AffineDisparity) => "-affine-disparity",
        }
    }

    /// True if the rules are already what the suffix would make of them, or cannot become it: a
    /// protocol with groups keeps them, and one whose own alignment is by least squares keeps that.
    fn says_nothing(self, rules: &Protocol) -> bool {
        match self {
            Self::Crop(crop) => rules.crop == crop,
            Self::Flip => rules.post_processing == PostProcessing::Flip,
            Self::Distance => rules.grouping != Grouping::None,
            // No suffix takes an alignment away, and only that by medians gives way to another.
            Self::Align(Alignment::None) => true,
            Self::Align(alignment) => {
                rules.alignment == alignment
                    || !matches!(rules.alignment, Alignment::None | Alignment::Median)
            }
        }
    }

    fn change(self, rules: &mut Protocol) {
        match self {
            Self::Crop(crop) => rules.crop = crop,
            Self::Flip => rules.post_processing = PostProcessing::Flip,
            Self::Distance => rules.grouping = Grouping::Distance,
            Self::Align(alignment) => rules.alignment = alignment,
        }
    }

    fn excludes(self, other: Self) -> bool {
        self == other
            || matches!(
                (self, other),
                (Self::Crop(_), Self::Crop(_)) | (Self::Align(_), Self::Align(_))
            )
    }
}

/// A protocol's name taken apart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProtocolName {
    base: String,
    /// In canonical order.
    suffixes: Vec<Suffix>,
}

impl ProtocolName {
    /// Takes a name apart. A base need not be known here; suffixes that contradict or repeat each
    /// other are left in it.
    #[must_use]
    pub fn parse(name: &str) -> Self {
        let (mut base, mut suffixes) = (name, Vec::new());
        while named(base).is_none() {
            let last = Suffix::ALL.into_iter().find_map(|suffix| {
                let rest = base.strip_suffix(suffix.as_str())?;
                (!rest.is_empty()).then_some((rest, suffix))
            });
            match last {
                Some((rest, suffix)) if !suffixes.iter().any(|s| suffix.excludes(*s)) => {
                    base = rest;
                    suffixes.push(suffix);
                }
                _ => break,
            }
        }
        let mut name = Self {
            base: base.to_owned(),
            suffixes,
        };
        name.sort();
        name
    }

    /// The name without its suffixes.
    #[must_use]
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Whether the suffix is part of the name.
    #[must_use]
    pub fn has(&self, suffix: Suffix) -> bool {
        self.suffixes.contains(&suffix)
    }

    /// The name with a suffix, in its place.
    #[must_use]
    pub fn with(mut self, suffix: Suffix) -> Self {
        self.suffixes.retain(|known| !suffix.excludes(*known));
        self.suffixes.push(suffix);
        self.sort();
        self
    }

    /// The name without a suffix.
    #[must_use]
    pub fn without(mut self, suffix: Suffix) -> Self {
        self.suffixes.retain(|known| *known != suffix);
        self
    }

    fn sort(&mut self) {
        let order = |suffix: &Suffix| Suffix::ALL.iter().position(|known| known == suffix);
        self.suffixes.sort_by_key(order);
    }
}

impl fmt::Display for ProtocolName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let suffixes: String = self.suffixes.iter().map(|suffix| suffix.as_str()).collect();
        f.pad(&format!("{}{suffixes}", self.base))
    }
}

impl Protocol {
    /// The same rules changed by a suffix, which becomes part of the name. Where they are already
    /// so, and where a protocol has groups and would get others, nothing changes.
    #[must_use]
    pub fn with(mut self, suffix: Suffix) -> Self {
        if !suffix.says_nothing(&self) {
            suffix.change(&mut self);
            self.name = ProtocolName::parse(&self.name).with(suffix).to_string();
        }
        self
    }
}

/// The protocol of that name: one of [`protocols`](super::protocols()), which any of
/// [`Suffix::ALL`] may follow in any order. Its own name is the canonical one.
///
/// `None` for an unknown name, and where a suffix repeats or contradicts what is already said.
#[must_use]
pub fn protocol(name: &str) -> Option<Protocol> {
    let ProtocolName { base, suffixes } = ProtocolName::parse(name);
    let mut rules = named(&base)?.clone();
    for suffix in suffixes {
        if suffix.says_nothing(&rules) {
            return None;
        }
        rules = rules.with(suffix);
    }
    Some(rules)
}

/// Canonical name and digest of a protocol that a row names in another order of suffixes, if the
/// digest shows that its rules are the ones known here. `None` where there is nothing to translate.
pub(crate) fn canonical(name: &str, digest: &str) -> Option<(String, String)> {
    let rules = protocol(name).filter(|rules| rules.name != name)?;
    let as_written = Protocol {
        name: name.to_owned(),
        ..rules.clone()
    };
    (as_written.digest() == digest).then(|| (rules.name.clone(), rules.digest()))
}
