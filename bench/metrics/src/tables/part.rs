//! The measured models that stand in one section of a table.

use super::coverage::Coverage;
use super::error::TableError;
use super::table::Section;
use crate::protocol::protocol;
use crate::rows::{ModelRows, Row, RowContext, by_model};
use crate::statistics::{Summary, summarise};

/// One model's rows under the section's protocol, and what they come to.
pub(super) struct Measured<'a> {
    pub(super) rows: ModelRows<'a>,
    pub(super) summary: Summary,
}

impl<'a> Measured<'a> {
    pub(super) fn context(&self) -> &'a RowContext {
        self.rows.context()
    }

    pub(super) fn images(&self) -> u64 {
        self.rows.images()
    }

    /// Name and seed of a model called `NAME@SEED`.
    pub(super) fn seed(&self) -> Option<(&'a str, &'a str)> {
        self.context().seed()
    }

    pub(super) fn display_name(&self) -> String {
        let context = self.context();
        match &context.variant {
            Some(variant) if !context.model.contains(variant.as_str()) => {
                format!("{} ({variant})", context.model)
            }
            _ => context.model.clone(),
        }
    }
}

/// The measured models of one section.
pub(super) struct Part<'a> {
    pub(super) protocol: String,
    /// The table's own protocol in this place, which says which published rows belong here.
    pub(super) own: &'static str,
    pub(super) digest: String,
    /// Images of the complete test set under the protocol.
    pub(super) expected: u64,
    pub(super) models: Vec<Measured<'a>>,
}

impl<'a> Part<'a> {
    pub(super) fn new(
        name: &str,
        own: &'static str,
        rows: &'a [Row],
        coverage: &Coverage,
    ) -> Result<Self, TableError> {
        let models = by_model(rows, name)?;
        // A protocol of the user's own is not known here; its rows must agree with each other.
        let digest = protocol(name)
            .map(|protocol| protocol.digest())
            .or_else(|| {
                models
                    .first()
                    .map(|model| model.context().protocol_digest.clone())
            });
        let digest = digest.unwrap_or_default();
        let expected = coverage.under(name);
        let mut measured = Vec::new();
        for rows in models {
            let context = rows.context();
            if context.protocol_digest != digest {
                return Err(TableError::Definition {
                    model: context.model.clone(),
                    protocol: name.to_owned(),
                    found: short(&context.protocol_digest).to_owned(),
                    expected: short(&digest).to_owned(),
                });
            }
            if rows.images() > expected {
                return Err(TableError::Excess {
                    model: context.model.clone(),
                    protocol: name.to_owned(),
                    found: rows.images(),
                    expected,
                });
            }
            if let Some(summary) = summarise(rows.rows()) {
                measured.push(Measured { rows, summary });
            }
        }
        Ok(Self {
            protocol: name.to_owned(),
            own,
            digest,
            expected,
            models: measured,
        })
    }

    /// The models by method, in the order of their first row. Models called `NAME@SEED` are
    /// seeds of one method if there are at least two of them; every other model is its own.
    pub(super) fn methods(&self) -> Vec<Vec<&Measured<'a>>> {
        let mut methods: Vec<Vec<&Measured<'a>>> = Vec::new();
        for entry in &self.models {
            let name = entry.seed().map(|(name, _)| name);
            let siblings = methods
                .iter_mut()
                .find(|method| name.is_some() && method[0].seed().map(|(name, _)| name) == name);
            match siblings {
                Some(method) => method.push(entry),
                None => methods.push(vec![entry]),
            }
        }
        methods
    }

    /// Some measured image has the further metrics in every row.
    pub(super) fn has_further(&self) -> bool {
        let mut models = self.models.iter();
        models.any(|model| model.summary.further.is_some())
    }

    pub(super) fn is_own(&self) -> bool {
        self.protocol == self.own
    }

    pub(super) fn competes(&self, model: &Measured<'_>, coverage: &Coverage) -> bool {
        self.is_own() && coverage.source.competes() && model.images() == self.expected
    }

    pub(super) fn data_digest(&self) -> String {
        let first = self.models.first();
        first.map_or_else(String::new, |model| model.context().data_digest.clone())
    }

    pub(super) fn section(&self, heading: Option<String>) -> Section {
        Section {
            heading,
            protocol: self.protocol.clone(),
            protocol_digest: self.digest.clone(),
            data_digest: self.data_digest(),
            expected_images: self.expected,
            lines: Vec::new(),
        }
    }
}

pub(super) fn one_data_set(parts: &[Part<'_>]) -> Result<(), TableError> {
    let mut contexts = parts
        .iter()
        .flat_map(|part| part.models.iter().map(Measured::context));
    let Some(first) = contexts.next() else {
        return Ok(());
    };
    match contexts.find(|other| other.data_digest != first.data_digest) {
        None => Ok(()),
        Some(second) => Err(TableError::Data {
            first: first.model.clone(),
            first_digest: short(&first.data_digest).to_owned(),
            second: second.model.clone(),
            second_digest: short(&second.data_digest).to_owned(),
        }),
    }
}

/// First twelve characters of a digest: enough to tell two apart in a heading.
pub(super) fn short(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}
