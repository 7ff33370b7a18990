"""Prepared sets as data for training."""

import multiprocessing
import pickle

import numpy as np
import pytest

import strat


def test_training_pairs_are_arrays(eigen):
    prepared = strat.PreparedSet(eigen)
    assert (prepared.content, prepared.source, len(prepared.data_digest)) == ("eigen", "rendered", 64)
    pair = prepared.train[0]
    assert pair["left"].dtype == np.uint8 and pair["left"].shape == pair["right"].shape
    assert pair["left"].shape[2] == 3 and pair["focal_px"] > 0 and pair["baseline_m"] > 0
    assert pair["id"] == prepared.train.ids[0] and pair["drive"] == pair["id"].split("/")[0]
    assert np.array_equal(prepared.train[-1]["left"], prepared.train[len(prepared.train) - 1]["left"])
    with pytest.raises(IndexError):
        prepared.train[len(prepared.train)]


def test_ground_truth_and_labels_come_with_the_images(sets):
    sample = strat.PreparedSet(sets / "eigen").test[0]
    size = (sample["height"], sample["width"])
    assert sample["depth_velodyne"].shape == sample["image"].shape[:2] == size
    assert sample["depth_velodyne"].dtype == np.float32 and sample["depth_velodyne"].max() > 1
    stereo = strat.PreparedSet(sets / "kitti").test[0]
    assert stereo["depth_noc"].shape == stereo["semantic"].shape
    assert stereo["semantic"].dtype == np.uint8


def test_samples_of_named_keys_read_nothing_else(eigen, tmp_path):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(eigen, copy)
    shutil.rmtree(copy / "depth")
    views = pickle.loads(pickle.dumps(strat.PreparedSet(copy).test.only("left", "focal_px")))
    whole = strat.PreparedSet(eigen).test
    assert views.ids == whole.ids and list(views[0]) == ["left", "focal_px"]
    assert np.array_equal(views[0]["left"], whole[0]["left"])
    with pytest.raises(ValueError, match='has no "depth_noc"; what was asked for and is there: .*left'):
        whole.only("left", "depth_noc")[0]


def first(samples):
    return samples[0]["left"].sum()


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_workers_take_a_set_as_it_is(eigen, method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} here")
    prepared = strat.PreparedSet(eigen)
    again = pickle.loads(pickle.dumps(prepared))
    assert again.train.ids == prepared.train.ids
    # What a DataLoader does: the parent has read, then others read.
    here = first(prepared.train)
    with multiprocessing.get_context(method).Pool(2) as workers:
        assert workers.map(first, [prepared.train] * 4) == [here] * 4


def test_a_changed_file_is_noticed(eigen, tmp_path):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(eigen, copy)
    name = strat.PreparedSet(copy).train.ids[0]
    drive, frame = name.split("/")
    (file,) = (copy / "images" / drive / "left").glob(f"{frame}.*")
    (other,) = (copy / "images" / drive / "right").glob(f"{frame}.*")
    file.write_bytes(other.read_bytes())
    with pytest.raises(ValueError, match="has changed since the set was prepared"):
        strat.PreparedSet(copy).train[0]


def test_what_is_no_set(tmp_path):
    with pytest.raises(OSError, match="has no manifest.yaml"):
        strat.PreparedSet(tmp_path)
