//! What is ranked together: submissions measured under one protocol (and group of it) on one data
//! set, with their places.

use std::collections::BTreeMap;

use rayon::prelude::*;
use strat_metrics::compare::TestOptions;
use strat_metrics::ranking::{Candidate, NoRank, Place, rank};
use strat_metrics::{Group, Grouping, Metric, Protocol, ProtocolName, Suffix, protocol};
use strat_splits::{Leakage, Recording, recording};

use crate::board::DataSet;
use crate::check::Checked;
use crate::published::Published;
use crate::submission::{Measured, Scored, Submission};

/// Measured rows that belong together.
#[derive(Debug)]
pub struct Section<'a> {
    /// Its name in addresses: protocol, group and the beginning of the data set's digest.
    pub id: String,
    /// The rules.
    pub protocol: Protocol,
    /// The group of pixels, for protocols with groups.
    pub group: Option<Group>,
    /// The data set.
    pub data: &'a DataSet,
    /// Images that a complete submission has.
    pub expected: u64,
    /// Images of the published test set.
    pub of_split: u64,
    /// The methods, best mean of the first metric first.
    pub methods: Vec<Method<'a>>,
    /// Why there are no ranks, by metric.
    pub no_rank: [Option<NoRank>; 7],
    /// Drives or other recordings of the images that complete methods share.
    pub recordings: usize,
}

/// A submission in a section.
#[derive(Debug)]
pub struct Method<'a> {
    /// The submission.
    pub submission: &'a Submission,
    /// Its rows under the protocol.
    pub scored: &'a Scored,
    /// Its numbers here.
    pub measured: &'a Measured,
    /// Where it stands, by metric.
    pub places: [Place; 7],
}

impl Method<'_> {
    /// Whether it was ranked: complete, and not trained on drives of the test.
    #[must_use]
    pub fn takes_part(&self) -> bool {
        self.measured.whole && !leaks(&self.scored.leakage)
    }
}

/// Whether a model was, or may have been, trained on drives of the test: what a split alone says
/// counts against it, silence does not.
#[must_use]
pub fn leaks(leakage: &Leakage) -> bool {
    matches!(leakage, Leakage::Drives { .. } | Leakage::OtherSplit { .. })
}

impl Section<'_> {
    /// The metric that ranks unless a reader asks for another one.
    #[must_use]
    pub fn first_metric(&self) -> Metric {
        first_metric(&self.protocol)
    }

    /// Why methods have no rank under its first metric.
    #[must_use]
    pub fn why_no_rank(&self) -> Option<&NoRank> {
        self.no_rank[self.first_metric() as usize].as_ref()
    }

    /// Name for people, without the protocol's.
    #[must_use]
    pub fn heading(&self) -> String {
        let group = self
            .group
            .map_or(String::new(), |group| format!("{group}, "));
        format!("{group}{}", self.data.name)
    }
}

/// The metric that ranks: Abs Rel, and RMSE where the thesis' table has nothing else.
#[must_use]
pub fn first_metric(protocol: &Protocol) -> Metric {
    match protocol.grouping {
        Grouping::Cityscapes => Metric::Rmse,
        _ => Metric::AbsRel,
    }
}

/// A protocol's name without its alignment, where that is a suffix: what shares a page.
#[must_use]
pub fn page_of(name: &str) -> String {
    let Some(rules) = protocol(name) else {
        return name.to_owned();
    };
    let stripped = Suffix::of_alignment(rules.alignment)
        .and_then(|suffix| name.strip_suffix(suffix.as_str()))
        .filter(|base| protocol(base).is_some());
    match stripped {
        Some(base) => ProtocolName::parse(base).to_string(),
        None => name.to_owned(),
    }
}

/// All sections of a leaderboard, in the order of the protocols in `bench protocols` and of the data sets in
/// the leaderboard's own file.
#[must_use]
pub fn sections(checked: &Checked) -> Vec<Section<'_>> {
    type Key<'a> = (&'a str, Option<Group>, &'a str);
    let mut found: BTreeMap<Key<'_>, Vec<Method<'_>>> = BTreeMap::new();
    for submission in &checked.submissions {
        for scored in &submission.scored {
            for measured in &scored.parts {
                let key = (
                    scored.protocol.as_str(),
                    measured.line.group,
                    scored.data_digest.as_str(),
                );
                found.entry(key).or_default().push(Method {
                    submission,
                    scored,
                    measured,
                    places: [Place::default(); 7],
                });
            }
        }
    }
    let mut sections: Vec<Section<'_>> = found
        .into_iter()
        .filter_map(|((name, group, digest), methods)| {
            // Both were known when the rows were checked.
            let data = checked.board.data_set(digest)?;
            Some(section(protocol(name)?, group, data, methods))
        })
        .collect();
    let order: Vec<String> = strat_metrics::protocols()
        .into_iter()
        .map(|one| one.name)
        .collect();
    sections.sort_by_key(|section| {
        let page = page_of(&section.protocol.name);
        let known = order.iter().position(|name| *name == page);
        (
            known.unwrap_or(order.len()),
            section.protocol.name.clone(),
            !section.data.competes(),
            (checked.board.data.iter()).position(|data| data.digest == section.data.digest),
            section.group,
        )
    });
    sections
}

fn section<'a>(
    protocol: Protocol,
    group: Option<Group>,
    data: &'a DataSet,
    mut methods: Vec<Method<'a>>,
) -> Section<'a> {
    type Ranked = (Vec<Place>, Option<NoRank>);
    let mut no_rank = [None; 7];
    // Under a group the same images for all who have predicted its pixels everywhere.
    let taking_part = (0..methods.len()).filter(|&index| methods[index].takes_part());
    let images = |index: usize| &methods[index].measured.images;
    let most = taking_part
        .clone()
        .max_by_key(|&index| (images(index).len(), usize::MAX - index));
    let taking_part: Vec<usize> = taking_part
        .filter(|&index| most.is_some_and(|most| images(index) == images(most)))
        .collect();
    let ranked: Vec<(usize, Ranked)> = Metric::ALL
        .into_par_iter()
        .map(|metric| {
            let of = |&index: &usize| candidate(methods[index].measured, metric);
            let candidates: Vec<Candidate> = taking_part.iter().map(of).collect();
            let recordings = candidates.first().map_or(0, |one| one.totals.len());
            let options = TestOptions::default();
            (
                recordings,
                rank(&candidates, metric.lower_is_better(), &options),
            )
        })
        .collect();
    let recordings = ranked.first().map_or(0, |(recordings, _)| *recordings);
    for (metric, (_, (places, why))) in ranked.into_iter().enumerate() {
        no_rank[metric] = why;
        for (&index, place) in taking_part.iter().zip(places) {
            methods[index].places[metric] = place;
        }
    }
    let first = first_metric(&protocol);
    let mean =
        |method: &Method<'_>| method.measured.line.metrics[first as usize].unwrap_or(f64::NAN);
    methods.sort_by(|a, b| {
        mean(a)
            .total_cmp(&mean(b))
            .then_with(|| a.submission.id.cmp(&b.submission.id))
    });
    let group_name = group.map_or(String::new(), |group| format!(".{group}"));
    Section {
        id: format!("{}{group_name}-{:.8}", protocol.name, data.digest),
        expected: data.under(&protocol.name),
        of_split: data.split_under(&protocol.name),
        protocol,
        group,
        data,
        methods,
        no_rank,
        recordings,
    }
}

fn candidate(measured: &Measured, metric: Metric) -> Candidate {
    let mut totals: BTreeMap<Recording<'_>, f64> = BTreeMap::new();
    for (image, values) in measured.images.iter().zip(&measured.values) {
        *totals.entry(recording(image)).or_default() += values[metric as usize];
    }
    Candidate {
        mean: measured.line.metrics[metric as usize].unwrap_or(f64::NAN),
        totals: totals.into_values().collect(),
    }
}

/// Published rows under a protocol and group.
pub(crate) fn published_under<'a>(
    rows: &'a [Published],
    protocol: &str,
    group: Option<Group>,
) -> Vec<&'a Published> {
    let group = group.map(|group| group.to_string());
    let fits = |row: &&Published| row.protocol == protocol && row.group == group;
    rows.iter().filter(fits).collect()
}
