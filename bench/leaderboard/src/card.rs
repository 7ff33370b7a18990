//! `card.yaml`: what a contributor says of a method. `bench publish` fills in what the run knows.

use serde::Deserialize;

use crate::board::quoted;
use crate::run::{Metadata, Run, RunModel};
use crate::text::{check_name, check_prose};

/// What stands where the contributor has to say something.
pub const FILL_IN: &str = "fill in";

/// What a method may have learned from.
pub const SUPERVISION: [&str; 8] = [
    "none",
    "monocular video",
    "stereo",
    "stereo video",
    "depth",
    "synthetic depth",
    "semi-supervised",
    "other",
];

/// A method, as its contributor describes it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Card {
    /// The name, as in the rows.
    pub method: String,
    /// One of [`SUPERVISION`].
    pub supervision: String,
    /// What it was trained on.
    pub training: String,
    /// Who submits it.
    pub authors: String,
    /// Licence of the model or the predictions.
    pub licence: String,
    /// Training variant.
    #[serde(default)]
    pub variant: Option<String>,
    /// Seed of the training.
    #[serde(default)]
    pub seed: Option<u64>,
    /// Device that the measurement ran on.
    #[serde(default)]
    pub device: Option<String>,
    /// Inference library with its version.
    #[serde(default)]
    pub runtime: Option<String>,
    /// Version of `bench`.
    #[serde(default)]
    pub bench: Option<String>,
    /// Number of weights.
    #[serde(default)]
    pub parameters: Option<u64>,
    /// Where to read more: an https address.
    #[serde(default)]
    pub link: Option<String>,
    /// The work to cite.
    #[serde(default)]
    pub citation: Option<String>,
    /// Anything else.
    #[serde(default)]
    pub notes: Option<String>,
    /// Why images are missing, where some are.
    #[serde(default)]
    pub partial: Option<String>,
}

impl Card {
    /// What is wrong with it, beside the record of the run.
    pub(crate) fn problems(&self, run: &Run) -> Vec<String> {
        let mut problems = Vec::new();
        let names = [
            ("method", Some(&self.method)),
            ("variant", self.variant.as_ref()),
            ("device", self.device.as_ref()),
            ("runtime", self.runtime.as_ref()),
            ("bench", self.bench.as_ref()),
        ];
        let prose = [
            ("training", Some(&self.training)),
            ("authors", Some(&self.authors)),
            ("licence", Some(&self.licence)),
            ("citation", self.citation.as_ref()),
            ("notes", self.notes.as_ref()),
            ("partial", self.partial.as_ref()),
        ];
        type Check = fn(&str) -> Result<(), String>;
        let names = names.map(|(key, text)| (key, text, check_name as Check));
        let prose = prose.map(|(key, text)| (key, text, check_prose as Check));
        for (key, text, check) in names.into_iter().chain(prose) {
            match text {
                Some(text) if text == FILL_IN => {
                    problems.push(format!("`{key}` is still to be filled in"));
                }
                Some(text) => {
                    let checked = check(text).err();
                    problems.extend(checked.map(|why| format!("`{key}: {}` {why}", shown(text))));
                }
                None => {}
            }
        }
        if !SUPERVISION.contains(&self.supervision.as_str()) {
            problems.push(format!(
                "`supervision: {}` is none of {}",
                shown(&self.supervision),
                SUPERVISION.join(", ")
            ));
        }
        if let Some(link) = &self.link {
            let odd = |c: char| c.is_whitespace() || c.is_control() || "<>\"'`".contains(c);
            if !link.starts_with("https://") || link.len() > 300 || link.contains(odd) {
                problems.push(format!("`link: {}` is not an https address", shown(link)));
            }
        }
        problems.extend(self.contradictions(run));
        problems
    }

    fn contradictions(&self, run: &Run) -> Vec<String> {
        let mut problems = Vec::new();
        let Some(model) = run.models.first() else {
            return problems;
        };
        if self.method != model.name {
            problems.push(format!(
                "`method: {}` is not the model of run.yaml, {}",
                shown(&self.method),
                shown(&model.name)
            ));
        }
        let known = model.metadata.clone().unwrap_or_default();
        if known.variant.is_some() && known.variant != self.variant {
            problems.push("`variant` is not that of run.yaml".to_owned());
        }
        if known.seed.is_some() && known.seed != self.seed {
            problems.push("`seed` is not that of run.yaml".to_owned());
        }
        problems
    }
}

/// A text of a stranger in a sentence on a terminal.
pub(crate) fn shown(text: &str) -> String {
    let cut: String = text.chars().take(60).collect();
    let points = if cut.len() < text.len() { "..." } else { "" };
    format!("{}{points}", cut.escape_debug())
}

/// A card with what the record of a run knows; `partial` where images are missing.
pub(crate) fn draft(run: &Run, model: &RunModel, partial: bool) -> String {
    let metadata = model.metadata.clone().unwrap_or_default();
    let line = |key: &str, value: &str, comment: &str| {
        let comment = if comment.is_empty() {
            String::new()
        } else {
            format!("  # {comment}")
        };
        format!("{key}: {}{comment}\n", quoted(value))
    };
    let optional = |key: &str, value: Option<String>| {
        value.map_or(String::new(), |value| format!("{key}: {value}\n"))
    };
    let filled = |text: &str| (!text.is_empty() && text != "none").then(|| quoted(text));
    let supervision = if model.metadata.is_some() {
        "stereo"
    } else {
        FILL_IN
    };
    let mut text = line(
        "method",
        &model.name,
        "name shown in tables; the rows carry it",
    );
    text += &line("supervision", supervision, &SUPERVISION.join(", "));
    text += &line(
        "training",
        &training(&metadata, model.note.as_deref()),
        "what it was trained on",
    );
    text += &line("authors", FILL_IN, "who submits it");
    text += &line(
        "licence",
        FILL_IN,
        "of the model or the predictions, such as MIT",
    );
    text += &optional("variant", metadata.variant.as_deref().map(quoted));
    text += &optional("seed", metadata.seed.map(|seed| seed.to_string()));
    text += &optional("device", filled(&model.provider));
    text += &optional("runtime", filled(&model.runtime));
    text += &line("bench", &run.tool_version, "");
    text += &optional(
        "parameters",
        model.parameters.map(|count| count.to_string()),
    );
    if partial {
        text += &line(
            "partial",
            FILL_IN,
            "why images are missing; it is then listed without a rank",
        );
    }
    text + "# link: https://...    citation: ...    notes: ...\n"
}

fn training(metadata: &Metadata, note: Option<&str>) -> String {
    let mut text = match (&metadata.split, note) {
        (Some(split), _) => format!("{split} split"),
        (None, _) if !metadata.train_drives.is_empty() => "KITTI raw".to_owned(),
        (None, Some(note)) if check_prose(note).is_ok() => return note.to_owned(),
        (None, _) => return FILL_IN.to_owned(),
    };
    match metadata.train_drives.len() {
        0 => {}
        1 => text += ", 1 drive",
        drives => text += &format!(", {drives} drives"),
    }
    if let Some(digest) = &metadata.train_data_digest {
        text += &format!(", data {digest:.12}");
    }
    if let Some(epoch) = metadata.epoch {
        text += &format!(", {epoch} epochs");
    }
    text
}
