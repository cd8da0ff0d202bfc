"""A dataset in every form, with the shape of its frames and maps."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pytest
from conftest import Service, command

import palpate._dataset
from palpate import Palpate, PalpateError
from palpate._rows import Rows, values_of


def test_the_rows_are_the_same_in_every_form(lab: Palpate[pl.DataFrame]) -> None:
    real = lab.dataset("real")
    rows = real.polars()
    assert len(real) == rows.height == real.info["rows"] > 100 and real.id.startswith("ds-")
    assert real.url.endswith(f"/api/v1/data/{real.id}.parquet") and "# real" in real.card()
    assert repr(real) == "Dataset('real')"
    frames = np.stack(list(real.pandas()["voltages_v"]))
    assert np.array_equal(frames, rows["voltages_v"].to_numpy()) and frames.shape == (len(real), 784)
    assert real.arrow().num_rows == len(real)
    assert real.scan().collect().equals(rows)
    assert pl.read_parquet(real.file()).equals(rows)


def test_a_selection_is_the_same_in_every_form(
    lab: Palpate[pl.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = lab.dataset("real")
    wanted = real.polars().filter(pl.col("split") == "train", pl.col("max_force_n") > 10)["trial_id"]
    assert len(wanted) > 5
    monkeypatch.setattr(palpate._dataset, "PAGE_ROWS", 7)
    for table in (
        real.polars(columns=["trial_id"], split="train", max_force_n__gt=10)["trial_id"].to_list(),
        real.pandas(columns=["trial_id"], split="train", max_force_n__gt=10)["trial_id"].to_list(),
        real.arrow(columns=["trial_id"], split="train", max_force_n__gt=10)["trial_id"].to_pylist(),
    ):
        assert table == wanted.to_list()
    assert real.polars(columns=["voltages_v"], slice="0:28").schema["voltages_v"] == pl.Array(pl.Float32, 28)


def test_force_maps_have_their_shape_and_the_forces_of_their_contacts(lab: Palpate[pl.DataFrame]) -> None:
    real = lab.dataset("real")
    rows = real.polars(map="20x60", columns=["trial_id", "contacts"])
    assert rows.schema["force_map_n"] == pl.Array(pl.Float32, (32, 32))
    maps = rows["force_map_n"].to_numpy()
    forces = rows["contacts"].list.eval(pl.element().struct.field("force_n")).list.sum().to_numpy()
    assert np.allclose(maps.sum(axis=(1, 2)), forces, rtol=1e-4)
    # Row 0 is at the lower edge: the centre of a single force is where its contact is.
    single = rows.with_row_index().filter(pl.col("contacts").list.len() == 1)
    for row, contacts in zip(single["index"], single["contacts"], strict=True):
        weights = maps[row] / maps[row].sum()
        centres = 20 * np.arange(32) + 10
        x, y = (weights.sum(0) * centres).sum() - 50, (weights.sum(1) * centres).sum() - 40
        assert x == pytest.approx(contacts[0]["x_mm"], abs=0.5)
        assert y == pytest.approx(contacts[0]["y_mm"], abs=0.5)
    # With both frames a page has fewer rows, so that the service accepts its numbers.
    both = lab.dataset("run-1")
    assert both.polars(map="20x60").height == len(both)
    frame = real.pandas(map="20x60", columns=["trial_id"])
    assert np.array_equal(np.stack(list(frame["force_map_n"])), maps)
    table = real.arrow(map="20x60", columns=["trial_id"])
    assert table.schema.field("force_map_n").type == pa.fixed_shape_tensor(pa.float32(), (32, 32))
    tensor = table["force_map_n"].combine_chunks()
    assert np.array_equal(tensor.to_numpy_ndarray(), maps)


def test_a_name_stays_with_the_rows_that_it_stood_for(service: Service, tmp_path: Path) -> None:
    lab = Palpate(service.url)
    definition = tmp_path / "some.toml"
    definition.write_text('name = "some"\ntask = "real"\nwhere = ["max_force_n__gt=10"]\n')
    command(service.data, "dataset", "make", str(definition), PALPATE_URL=service.url)
    before = lab.dataset("some")
    count = len(before)
    definition.write_text('name = "some"\ntask = "real"\nwhere = ["max_force_n__gt=15"]\n')
    command(service.data, "dataset", "make", str(definition), PALPATE_URL=service.url)
    assert len(lab.dataset("some")) < count == before.polars().height
    assert lab.dataset(before.id).polars().equals(before.polars())


def test_an_unknown_dataset_is_refused_in_the_words_of_the_service(lab: Palpate[pl.DataFrame]) -> None:
    with pytest.raises(PalpateError, match="no-such") as refused:
        lab.dataset("no-such").polars()
    assert refused.value.status == 404
    with pytest.raises(PalpateError, match="map") as refused:
        lab.dataset("real").polars(map="7x20")
    assert refused.value.status == 400


def test_a_file_that_fails_midway_leaves_nothing(lab: Palpate[pl.DataFrame], tmp_path: Path) -> None:
    with pytest.raises(PalpateError):
        lab.dataset("real")._rows_file(("voltages_v",), "4x20", tmp_path, {"no_column": 1})
    assert list(tmp_path.iterdir()) == []


def test_rows_of_a_file_are_read_one_at_a_time_with_their_shape(
    lab: Palpate[pl.DataFrame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = lab.dataset("real")
    monkeypatch.setattr(palpate._dataset, "PAGE_ROWS", 50)
    columns = ("voltages_v", "force_map_n", "max_force_n")
    file = real._rows_file(columns, "10x30", tmp_path, {})
    assert real._rows_file(columns, "10x30", tmp_path, {}) == file and len(list(tmp_path.iterdir())) == 1
    rows = Rows(file, columns)
    whole = real.polars(columns=["voltages_v", "max_force_n"], map="10x30")
    count = len(whole)
    assert len(rows) == count > 100
    for n in (0, 49, 50, count - 1, -1):
        frame, forces, force_n = rows[n]
        assert frame.shape == (28, 28) and forces.shape == (64, 64)
        assert frame.ravel().tolist() == whole["voltages_v"][n].to_list()
        assert np.array_equal(forces, whole["force_map_n"].to_numpy()[n])
        assert force_n == whole["max_force_n"][n]
    with pytest.raises(IndexError, match=f"row {count}: there are {count}"):
        rows[count]
    assert np.array_equal(pickle.loads(pickle.dumps(rows))[60][0], rows[60][0])


def test_rows_without_a_value_are_excluded_and_counted(
    lab: Palpate[pl.DataFrame], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = lab.dataset("run-1")
    known = run.polars(columns=["depth_error_mm", "settle_ms", "fvu"])
    table = pa.table({"x": pa.array([1.0, None, 3.0]), "y": pa.array([[1.0], [2.0], None], pa.list_(pa.float64(), 1))})
    with pa.OSFile(str(tmp_path / "few.arrows"), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    assert [row[0] for row in Rows(tmp_path / "few.arrows", ("x", "y"))] == [1.0]  # type: ignore[attr-defined]
    assert "2 of 3 rows have no x or y: excluded" in capsys.readouterr().err
    twins = Rows(run._rows_file(("sim_voltages_v", "fvu"), "4x20", tmp_path, {}), ("sim_voltages_v", "fvu"))
    assert len(twins) == known["fvu"].count()


def test_x_and_y_must_be_numbers(lab: Palpate[pl.DataFrame], tmp_path: Path) -> None:
    for column in ("label", "contacts", "measured_at"):
        file = lab.dataset("real")._rows_file((column,), "4x20", tmp_path, {})
        with pytest.raises(TypeError, match=f"{column} is .*must be numbers"):
            Rows(file, (column,))
    part = pa.array([[1, 2], [3, 4], [5, 6]], pa.list_(pa.int32(), 2)).slice(1)
    assert values_of(part, "forces_n").tolist() == [[3, 4], [5, 6]]


def test_torch_reads_frames_and_maps(lab: Palpate[pl.DataFrame]) -> None:
    torch = pytest.importorskip("torch", reason="SKIPPED: torch is not installed", exc_type=ImportError)
    real = lab.dataset("real")
    train = real.torch(map="20x60", split="train")
    x, y = train[0]
    assert x.shape == (28, 28) and y.shape == (32, 32) and x.dtype == y.dtype == torch.float32
    first = real.polars(split="train", columns=["voltages_v"])
    assert len(train) == first.height and x.flatten().tolist() == first["voltages_v"][0].to_list()
    xs, ys = next(iter(torch.utils.data.DataLoader(train, batch_size=8, num_workers=2)))
    assert xs.shape == (8, 28, 28) and ys.shape == (8, 32, 32)
    count = real.torch(y="contact_count")[0][1]
    assert count.shape == () and int(count) == real.polars(columns=["contact_count"])["contact_count"][0]
    assert repr(train) == f"TrialDataset(x='voltages_v', y='force_map_n', rows={first.height})"
