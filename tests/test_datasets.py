"""Folders of images become traversals, or an error that names the file."""

import numpy as np
import pytest
from conftest import THUMBNAIL, real_data_root, tiny_manifest, write_images, write_manifest
from hypothesis import given
from hypothesis import strategies as st

from artifact import datasets, manifest
from artifact.datasets import DatasetError
from artifact.datasets.positions import keep_spacing
from artifact.manifest.entries import ManifestError


def street(threshold, **traversals):
    return {
        "title": "Street",
        "kind": "folder",
        "threshold": threshold,
        "query": "day",
        "database": "night",
        "traversals": {"day": {"condition": "day"}, "night": {"condition": "night"}} | traversals,
    }


METRES = {"value": 25, "unit": "metres"}


@pytest.fixture
def with_csv(tmp_path):
    def build(rows, header="image,x,y"):
        for name in ("day", "night"):
            write_images(tmp_path / "data" / "street" / name, 3, seed=1)
            text = "\n".join([header, *rows]) + "\n"
            (tmp_path / "data" / "street" / name / "positions.csv").write_text(text)
        return manifest.load(write_manifest(tmp_path, tiny_manifest(street=street(METRES))))

    return build


def test_frame_order_is_natural(project):
    loaded = datasets.load(manifest.load(project / "data_manifest.yaml"), "street")
    assert loaded.query.image_names == tuple(f"frame{i}.png" for i in range(12))
    np.testing.assert_array_equal(loaded.query.positions, np.arange(12.0)[:, None])
    assert (loaded.threshold, loaded.unit, loaded.real) == (1, "frames", True)


def test_positions_in_metres_follow_the_images_not_the_rows(with_csv):
    loaded = datasets.load(with_csv(["frame2.png,20,2", "frame0.png,0,0", "frame1.png,10,1"]), "street")
    np.testing.assert_array_equal(loaded.query.positions, [[0, 0], [10, 1], [20, 2]])


def test_three_axes_and_a_byte_order_mark(with_csv):
    loaded = datasets.load(
        with_csv(["frame0.png,0,0,1", "frame1.png,1,0,2", "frame2.png,2,0,3"], "\ufeffImage, X,y,z"), "street"
    )
    np.testing.assert_array_equal(loaded.query.positions[:, 2], [1, 2, 3])


@pytest.mark.parametrize(
    ("rows", "header", "message"),
    [
        (["frame0.png,0,0"], "picture,x,y", r"positions.csv:1: the header is 'picture,x,y'; allowed: 'image,x,y'"),
        (
            ["frame0.png,0,0", "frame0.png,1,1"],
            "image,x,y",
            r"positions.csv:3: a second row for the image 'frame0.png'",
        ),
        (["frame0.png,0"], "image,x,y", r"positions.csv:2: 2 fields where the header has 3"),
        (["frame0.png,0,north"], "image,x,y", r"positions.csv:2: found '0,north'; positions must be numbers"),
        (["frame0.png,0,0"], "image,x,y", r"no row for 2 of 3 images, first 'frame1.png'"),
        (
            ["frame0.png,0,0", "frame1.png,nan,0", "frame2.png,0,0"],
            "image,x,y",
            r"position of 'frame1.png' is not a finite number",
        ),
        (
            ["frame0.png,0", "frame1.png,1", "frame2.png,2"],
            "image,index",
            "threshold is in metres but the positions are in frames",
        ),
    ],
)
def test_bad_csv_is_named_with_its_line(with_csv, rows, header, message):
    with pytest.raises(DatasetError, match=message):
        datasets.load(with_csv(rows, header), "street")


def test_utm_names_and_an_at_sign_in_a_parent_folder(tmp_path):
    root = tmp_path / "me@home" / "data" / "street"
    for part, shift in (("day", 0), ("night", 5)):
        write_images(root / part, 3, seed=1)
        for index, path in enumerate(sorted((root / part).glob("*.png"))):
            path.rename(root / part / f"@{500000 + 10 * index + shift:.2f}@{4000000:.2f}@30@U@.png")
    loaded = datasets.load(
        manifest.load(write_manifest(root.parents[1], tiny_manifest(street=street(METRES)))), "street"
    )
    np.testing.assert_array_equal(loaded.query.positions, [[500000, 4e6], [500010, 4e6], [500020, 4e6]])
    (root / "day" / "plain.png").write_bytes((root / "day" / loaded.query.image_names[0]).read_bytes())
    with pytest.raises(ManifestError, match=r"3 of 4 names hold @utm_east@utm_north@, 'plain.png' does not"):
        datasets.load(manifest.load(root.parents[1] / "data_manifest.yaml"), "street")


def test_an_image_list_selects_and_orders(project):
    (project / "data" / "street" / "list.txt").write_text("frame7.png\nframe3.png\n\n")
    listed = {"day": {"condition": "day", "image_list": "list.txt"}}
    path = write_manifest(project, tiny_manifest(street=street({"value": 1, "unit": "frames"}, **listed)))
    assert datasets.load(manifest.load(path), "street").query.image_names == ("frame7.png", "frame3.png")
    (project / "data" / "street" / "list.txt").write_text("frame7.png\nframe99.png\n")
    with pytest.raises(DatasetError, match=r"list.txt: 1 of its 2 images are not in .*, first 'frame99.png'"):
        datasets.load(manifest.load(path), "street")


def test_pairs_need_partners_of_the_same_name(tmp_path):
    for name, n in (("day", 3), ("night", 4)):
        write_images(tmp_path / "data" / "street" / name, n, seed=1, suffix=".png" if name == "day" else ".jpg")
    content = tiny_manifest(street=street({"value": 0, "unit": "pairs"}))
    loaded = manifest.load(write_manifest(tmp_path, content))
    with pytest.raises(DatasetError, match="1 names have no partner, first 'frame3'"):
        datasets.load(loaded, "street")
    (tmp_path / "data" / "street" / "night" / "frame3.jpg").unlink()
    assert len(datasets.load(loaded, "street").query) == 3


def test_other_counts_than_the_papers_are_said_and_do_not_stop(project):
    entry = street({"value": 1, "unit": "frames"}) | {"paper": {"queries": 12, "database": 13, "evaluated": 1187}}
    loaded = manifest.load(write_manifest(project, tiny_manifest(street=entry)))
    assert datasets.load(loaded, "street").differences == (
        "Street: 12 database images, the paper lists 13",
        "Street: 12 evaluated queries, the paper lists 1,187",
    )


def test_missing_folders_say_how_to_obtain_the_dataset(tmp_path):
    entry = street(METRES) | {
        "sources": [{"url": "https://example.org/a.zip", "note": "(200 MB)"}],
        "obtain": "Unpack it.",
    }
    loaded = manifest.load(write_manifest(tmp_path, tiny_manifest(street=entry)))
    with pytest.raises(DatasetError) as caught:
        datasets.load(loaded, "street")
    text = str(caught.value)
    for part in (
        str(tmp_path / "data" / "street" / "day"),
        "ARTIFACT_DATA_ROOT",
        "https://example.org/a.zip (200 MB)",
        "Unpack it.",
    ):
        assert part in text


def test_an_empty_folder_and_unknown_names(project):
    loaded = manifest.load(project / "data_manifest.yaml")
    with pytest.raises(
        ManifestError, match="no dataset 'avenue'; the datasets are 'street', and 'avenue' is no folder in"
    ):
        datasets.load(loaded, "avenue")
    with pytest.raises(ManifestError, match="no traversal 'dawn'; the traversals are day, night"):
        datasets.load(loaded, "street", ["dawn"])
    for path in (project / "data" / "street" / "day").glob("*"):
        path.unlink()
    with pytest.raises(DatasetError, match="no images in it; files with these endings count: .jpg"):
        datasets.load(loaded, "street")


# -- a folder of one's own ------------------------------------------------------------------------------------------


def test_a_folder_with_queries_and_database_needs_no_manifest_entry(project):
    own = project / "own"
    for part in ("queries", "gallery"):
        write_images(own / part, 4, seed=3)
    loaded = datasets.load(manifest.load(project / "data_manifest.yaml"), str(own))
    assert (loaded.title, loaded.unit, loaded.threshold, len(loaded.database)) == ("own", "frames", 1, 4)
    rows = "\n".join(f"frame{i}.png,{i * 30},0" for i in range(4))
    for part in ("queries", "gallery"):
        (own / part / "positions.csv").write_text(f"image,x,y\n{rows}\n")
    loaded = datasets.load(manifest.load(project / "data_manifest.yaml"), str(own))
    assert (loaded.unit, loaded.threshold) == ("metres", 25)


def test_a_folder_may_describe_itself(project):
    own = project / "own"
    write_images(own / "summer", 4, seed=3)
    write_images(own / "winter", 4, seed=3)
    (own / "dataset.yaml").write_text(
        "title: Own\nkind: folder\nthreshold: {value: 2, unit: frames}\nquery: summer\ndatabase: winter\n"
        "traversals: {summer: {condition: summer}, winter: {condition: winter}}\n"
    )
    loaded = manifest.load(project / "data_manifest.yaml")
    assert datasets.load(loaded, str(own)).threshold == 2
    (own / "dataset.yaml").write_text((own / "dataset.yaml").read_text().replace("unit: frames", "unit: steps"))
    with pytest.raises(
        ManifestError, match=r"dataset.yaml:3: threshold.unit: found 'steps'; allowed: 'metres', 'frames' or 'pairs'"
    ):
        datasets.load(loaded, str(own))


def test_a_folder_without_the_layout_says_what_it_should_have(project):
    with pytest.raises(ManifestError, match="expected one folder named queries or query, found 0"):
        datasets.load(manifest.load(project / "data_manifest.yaml"), str(project / "data"))


# -- content, spacing -----------------------------------------------------------------------------------------------


def test_the_digest_follows_bytes_names_and_order(project):
    loaded = manifest.load(project / "data_manifest.yaml")
    first = datasets.load_traversal(loaded, "street", "day")
    assert datasets.load_traversal(loaded, "street", "day").digest == first.digest
    path = project / "data" / "street" / "day" / "frame4.png"
    other = (project / "data" / "street" / "day" / "frame5.png").read_bytes()
    path.write_bytes(other)
    assert datasets.load_traversal(loaded, "street", "day").digest != first.digest


@given(st.lists(st.floats(0, 3), min_size=1, max_size=60), st.floats(0.1, 5))
def test_spacing_keeps_the_first_frame_and_then_every_frame_far_enough(steps, spacing):
    positions = np.cumsum(steps)[:, None]
    kept = keep_spacing(positions, spacing)
    assert kept[0] == 0
    gaps = np.diff(positions[kept, 0])
    assert (gaps >= spacing).all()
    for before, after in zip(kept, [*kept[1:], len(steps)], strict=True):
        skipped = positions[before + 1 : after, 0] - positions[before, 0]
        assert (np.abs(skipped) < spacing).all()


def test_spacing_thins_a_traversal(with_csv, tmp_path):
    with_csv(["frame0.png,0,0", "frame1.png,0.4,0", "frame2.png,1.1,0"])
    content = tiny_manifest(street=street(METRES, day={"condition": "day", "spacing": 1.0}))
    loaded = datasets.load(manifest.load(write_manifest(tmp_path, content)), "street")
    assert loaded.query.image_names == ("frame0.png", "frame2.png")


@pytest.mark.data
def test_gardens_point_images_are_the_shipped_ones():
    """The images under the data root are those that the shipped descriptors were made from."""
    from conftest import REPOSITORY

    from artifact.datasets import shipped

    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    assert loaded.data_root == real_data_root().resolve()
    for name in ("day_left", "day_right", "night_right"):
        traversal = datasets.load_traversal(loaded, "gardens_point", name)
        assert traversal.has_images
        assert shipped.traversal("gardens_point", name) == (list(traversal.image_names), traversal.digest)


def test_gardens_point_without_images_is_known_from_the_shipped_record(tmp_path):
    entry = {
        "title": "Gardens Point",
        "kind": "folder",
        "root": "gardens_point",
        "threshold": {"value": 2, "unit": "frames"},
        "query": "day_right",
        "database": "night_right",
        "traversals": {"day_right": {"condition": "day"}, "night_right": {"condition": "night"}},
    }
    content = tiny_manifest(gardens_point=entry)
    content["methods"]["thumbnail"] = THUMBNAIL
    loaded = datasets.load(manifest.load(write_manifest(tmp_path, content)), "gardens_point")
    assert len(loaded.query) == 200
    assert not loaded.query.has_images
    with pytest.raises(DatasetError, match="the images are not on this machine; set ARTIFACT_DATA_ROOT"):
        loaded.query.image_paths()
