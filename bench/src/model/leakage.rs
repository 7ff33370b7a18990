//! Whether a model was trained on places it is now tested on: [`strat_splits::leakage()`] for what a
//! model's metadata tells. Not here: what is done about it; the tables are still made.

use strat_onnx::metadata::ModelMetadata;
pub use strat_splits::Leakage;
use strat_splits::{Training, leakage};
use strat_store::set::{Content, Sample};

/// Compares the training that `metadata` tells of with the test images of `tested`.
pub fn check(metadata: Option<&ModelMetadata>, tested: Content, samples: &[Sample]) -> Leakage {
    let training = metadata.map(|metadata| Training {
        split: metadata.split.as_deref(),
        drives: &metadata.train_drives,
        unknown_start: metadata.unknown_start.is_some(),
    });
    let images = samples.iter().map(|sample| sample.id.as_str());
    leakage(training, &tested.to_string(), images)
}

#[cfg(test)]
mod tests {
    use strat_onnx::metadata::{InputRange, OutputMeaning};
    use strat_store::set::FileRef;

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
