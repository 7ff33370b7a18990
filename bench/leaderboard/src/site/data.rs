//! The numbers of each image, as scripts that the comparison page loads.
//!
//! `data/index.js` names sections and methods, `data/SECTION/images.js` the images with their
//! recordings, `data/SECTION/METHOD.js` seven metrics an image in 32-bit floats, base64 in
//! little-endian order. `data/index.js` also has the key of the sign patterns that p values of more than
//! sixteen recordings are drawn with, so that a browser gets those of `bench compare`.

use std::collections::{BTreeMap, BTreeSet};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use strat_metrics::Metric;
use strat_metrics::compare::{EXACT_UP_TO, TestOptions};
use strat_splits::{Recording, recording};

use super::memory::Site;
use crate::section::{Method, Section};

pub(super) fn add(site: &mut Site, sections: &[Section<'_>]) {
    site.add("data/index.js", script("index", "", &index(sections)));
    for section in sections {
        let ids: BTreeSet<&str> = section
            .methods
            .iter()
            .flat_map(|method| &method.measured.images)
            .map(String::as_str)
            .collect();
        let ids: Vec<&str> = ids.into_iter().collect();
        let path = format!("data/{}", section.id);
        site.add(
            format!("{path}/images.js"),
            script("images", &section.id, &images(&ids)),
        );
        for method in &section.methods {
            let id = &method.submission.id;
            let key = format!("{}/{id}", section.id);
            site.add(
                format!("{path}/{id}.js"),
                script("values", &key, &values(method, &ids)),
            );
        }
    }
}

/// A call with plain values: nothing in JSON ends a script, and a file has no markup around it.
fn script(kind: &str, key: &str, value: &Value) -> String {
    let text = value
        .to_string()
        .replace('<', "\\u003c")
        .replace('\u{2028}', "\\u2028")
        .replace('\u{2029}', "\\u2029");
    format!(
        "strat({}, {}, {text});\n",
        Value::from(kind),
        Value::from(key)
    )
}

fn index(sections: &[Section<'_>]) -> Value {
    let of = |section: &Section<'_>| {
        let methods = section
            .methods
            .iter()
            .map(|method| json!([method.submission.id, method.submission.card.method]));
        json!({
            "id": section.id,
            "title": format!("{}: {}", section.protocol.name, section.heading()),
            "protocol": section.protocol.name,
            "rendered": section.data.source == "rendered",
            "first": section.first_metric().name(),
            "methods": methods.collect::<Vec<_>>(),
        })
    };
    let metrics = Metric::ALL
        .map(|metric| json!([metric.name(), metric.heading(), metric.lower_is_better()]));
    let options = TestOptions::default();
    json!({
        "metrics": metrics,
        "flips": {
            "exact": EXACT_UP_TO,
            "draws": options.permutations,
            "key": STANDARD.encode(options.key()),
        },
        "sections": sections.iter().map(of).collect::<Vec<_>>(),
    })
}

/// Ids with the index of each image's recording.
fn images(ids: &[&str]) -> Value {
    let all: BTreeSet<Recording<'_>> = ids.iter().map(|id| recording(id)).collect();
    let indices: BTreeMap<&Recording<'_>, usize> = all.iter().zip(0..).collect();
    let of: Vec<usize> = ids.iter().map(|id| indices[&recording(id)]).collect();
    let names: Vec<String> = all.iter().map(ToString::to_string).collect();
    json!({"ids": ids, "recordings": names, "of": of})
}

fn values(method: &Method<'_>, ids: &[&str]) -> Value {
    let measured = method.measured;
    let numbers = measured.values.iter().flatten().map(|value| *value as f32);
    let bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
    let indices: Vec<usize> = measured
        .images
        .iter()
        .filter_map(|id| ids.binary_search(&id.as_str()).ok())
        .collect();
    // Complete submissions have them all.
    let indices = (indices.len() < ids.len()).then_some(indices);
    json!({"images": indices, "values": STANDARD.encode(bytes)})
}
