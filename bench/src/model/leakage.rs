//! Whether a model was trained on places it is now tested on: [`strat_splits::leakage()`] for what a
//! model's metadata tells. Not here: what is done about it; the tables are still made.

use std::collections::BTreeSet;

use strat_metrics::tables::Source;
use strat_onnx::metadata::ModelMetadata;
pub use strat_splits::Leakage;
use strat_splits::{Training, leakage};
use strat_store::set::{Content, Manifest, Sample};

/// The images that a model is tested on.
#[derive(Clone, Copy, Debug)]
pub struct Tested<'a> {
    /// What their set was made of.
    pub content: Content,
    /// Where they come from, as in its manifest: `kitti`, `rendered`, or the name of a collection.
    pub source: &'a str,
    /// Their samples.
    pub samples: &'a [Sample],
    /// Where the training images came from, for a model that does not say it itself.
    pub training_source: Option<&'a str>,
}

impl<'a> Tested<'a> {
    /// The test samples of a set.
    #[must_use]
    pub fn new(manifest: &'a Manifest, samples: &'a [Sample]) -> Self {
        Self {
            content: manifest.content,
            source: &manifest.source,
            samples,
            training_source: None,
        }
    }

    /// Where a model's training images came from, if its world is another: of the training and test images,
    /// the ones are rendered and the others are not. Drives of the rendered world bear KITTI's names, but
    /// no place of it was ever recorded.
    #[must_use]
    pub fn other_world<'m>(&'m self, metadata: Option<&'m ModelMetadata>) -> Option<&'m str> {
        let said = metadata.and_then(|metadata| metadata.train_source.as_deref());
        let trained = said.or(self.training_source)?;
        (is_rendered(trained) != is_rendered(self.source)).then_some(trained)
    }
}

fn is_rendered(source: &str) -> bool {
    Source::from(source) == Source::Rendered
}

/// Compares the training that `metadata` tells of with the test images.
pub fn check(metadata: Option<&ModelMetadata>, tested: &Tested<'_>) -> Leakage {
    let unknown_start = metadata.is_some_and(|metadata| metadata.unknown_start.is_some());
    if !unknown_start && tested.other_world(metadata).is_some() {
        return Leakage::None;
    }
    let training = metadata.map(|metadata| Training {
        split: metadata.split.as_deref(),
        drives: &metadata.train_drives,
        unknown_start,
    });
    let images = tested.samples.iter().map(|sample| sample.id.as_str());
    leakage(training, &tested.content.to_string(), images)
}

/// Compares the training images of one prepared set with the test images of another.
pub fn between(trained: (&Manifest, &[Sample]), tested: &Tested<'_>) -> Leakage {
    let (manifest, training) = trained;
    if is_rendered(&manifest.source) != is_rendered(tested.source) {
        return Leakage::None;
    }
    let drives = training
        .iter()
        .filter_map(|sample| sample.id.split_once('/'));
    let drives: BTreeSet<String> = drives.map(|(drive, _)| drive.to_owned()).collect();
    let split = manifest.content.to_string();
    let training = Training {
        split: Some(&split),
        drives: &Vec::from_iter(drives),
        unknown_start: false,
    };
    let images = tested.samples.iter().map(|sample| sample.id.as_str());
    leakage(Some(training), &tested.content.to_string(), images)
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::{InputRange, OutputMeaning};
    use strat_store::{
        resize::Kernel,
        set::{FORMAT, FileRef},
    };

    use super::*;

    fn samples(ids: &[&str]) -> Vec<Sample> {
        let file = FileRef {
            path: "images/x.png".into(),
            blake3: String::new(),
        };
        ids.iter()
            .map(|id| Sample::new(*id, (1242, 375), 721.5377, 0.54, file.clone()))
            .collect()
    }

    fn check(metadata: Option<&ModelMetadata>, content: Content, samples: &[Sample]) -> Leakage {
        super::check(metadata, &tested(content, samples))
    }

    fn tested(content: Content, samples: &[Sample]) -> Tested<'_> {
        Tested {
            content,
            source: "kitti",
            samples,
            training_source: None,
        }
    }

    fn trained_on(split: &str, drives: &[&str]) -> ModelMetadata {
        let mut metadata =
            ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 512, 256);
        metadata.split = Some(split.to_owned());
        metadata.train_drives = drives.iter().map(|drive| (*drive).to_owned()).collect();
        metadata
    }

    #[test]
    fn a_stereo_image_counts_as_a_frame_of_the_drive_it_came_from() {
        // PROTOCOL 2.4: image 2 is frame 10 of drive 0005, which the Eigen split trains on.
        let metadata = trained_on("eigen", &["2011_09_26_drive_0005"]);
        let tested = samples(&["kitti2015/000000", "kitti2015/000002", "kitti2015/000003"]);
        assert_eq!(
            check(Some(&metadata), Content::Kitti, &tested),
            Leakage::Drives {
                drives: vec!["2011_09_26_drive_0005".into()],
                images: 2,
            }
        );
    }

    #[test]
    fn another_split_without_a_common_drive_is_no_leakage() {
        let metadata = trained_on("eigen", &["2011_09_26_drive_0001"]);
        let tested = samples(&["kitti2015/000002"]);
        assert_eq!(
            check(Some(&metadata), Content::Kitti, &tested),
            Leakage::None
        );
    }

    #[test]
    fn a_model_that_began_with_weights_of_unknown_training_is_not_cleared() {
        let mut metadata = trained_on("eigen", &["2011_09_26_drive_0001"]);
        metadata.unknown_start = Some("ff00".into());
        let other = samples(&["2011_09_26_drive_0002/0000000069"]);
        let check = |samples: &[Sample]| check(Some(&metadata), Content::Eigen, samples);
        assert_eq!(check(&other), Leakage::Unknown);
        let own = samples(&["2011_09_26_drive_0001/0000000005"]);
        assert!(matches!(check(&own), Leakage::Drives { images: 1, .. }));
    }

    /// Also where the model itself does not say where its images came from.
    #[test]
    fn names_of_drives_mean_nothing_between_worlds() {
        let mut metadata = trained_on("eigen", &["2011_09_26_drive_0005"]);
        let images = samples(&["kitti2015/000002"]);
        let mut on = tested(Content::Kitti, &images);
        let leaks = |metadata: &ModelMetadata, on: &Tested<'_>| {
            matches!(super::check(Some(metadata), on), Leakage::Drives { .. })
        };
        assert!(leaks(&metadata, &on));
        on.training_source = Some("kitti");
        assert!(leaks(&metadata, &on));
        on.training_source = Some("rendered");
        assert!(!leaks(&metadata, &on));
        // What the model says of itself counts more.
        metadata.train_source = Some("kitti".to_owned());
        assert!(leaks(&metadata, &on));
        metadata.train_source = Some("rendered".to_owned());
        on.training_source = None;
        assert_eq!(on.other_world(Some(&metadata)), Some("rendered"));
        assert!(!leaks(&metadata, &on));
        on.source = "rendered";
        assert!(leaks(&metadata, &on));
        on.source = "kitti";
        metadata.unknown_start = Some("ff00".to_owned());
        assert!(leaks(&metadata, &on));
    }

    #[test]
    fn sets_share_places_only_where_both_were_recorded_or_both_rendered() {
        let manifest = |source: &str| Manifest {
            format: FORMAT,
            content: Content::Eigen,
            split_digest: None,
            source: source.to_owned(),
            image_width: 512,
            image_height: 256,
            kernel: Kernel::Area,
            codec: "png".to_owned(),
            counts: [].into(),
            failures: 0,
            cameras: Vec::new(),
            tool_version: String::new(),
            data_digest: String::new(),
        };
        let training = samples(&["2011_09_26_drive_0005/0000000001"]);
        let tested = samples(&["kitti2015/000002", "kitti2015/000003"]);
        let found = |trained: &str, tested_on: &str| {
            let (trained, tested_on) = (manifest(trained), manifest(tested_on));
            between((&trained, &training), &Tested::new(&tested_on, &tested))
        };
        let leaks = Leakage::Drives {
            drives: vec!["2011_09_26_drive_0005".into()],
            images: 2,
        };
        assert_eq!(found("kitti", "kitti"), leaks);
        assert_eq!(found("rendered", "rendered"), leaks);
        assert_eq!(found("rendered", "kitti"), Leakage::None);
        assert_eq!(found("kitti", "rendered"), Leakage::None);
    }

    #[test]
    fn without_drives_the_split_decides() {
        let tested = samples(&["2011_09_26_drive_0002/0000000069"]);
        let other = trained_on("kitti", &[]);
        assert_eq!(
            check(Some(&other), Content::Eigen, &tested),
            Leakage::OtherSplit {
                trained: "kitti".into()
            }
        );
        let same = trained_on("eigen", &[]);
        assert_eq!(check(Some(&same), Content::Eigen, &tested), Leakage::None);
        let make3d = samples(&["test/img-op57"]);
        assert_eq!(check(Some(&same), Content::Make3d, &make3d), Leakage::None);
        assert_eq!(check(None, Content::Eigen, &tested), Leakage::Unknown);
    }
}
