"""Every text in a file is found and can be replaced alone."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from verification.inputs.texts import text_at, texts_in, with_text


def parquet():
    table = pa.table({"callsign": ["A", "B", "A"], "cycle": [0, 1, 2]})
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata({"sector": '{"name": "x"}', "p": "t"}), sink)
    return sink.getvalue().to_pybytes()


def onnx():
    helper = pytest.importorskip("onnx").helper
    kind = helper.make_tensor_value_info("seen", 1, ["batch", 2])
    graph = helper.make_graph([helper.make_node("Neg", ["seen"], ["out"])], "g", [kind], [])
    model = helper.make_model(graph)
    helper.set_model_props(model, {"experiment": "lateral"})
    return model.SerializeToString()


@pytest.mark.parametrize(
    ("name", "make", "expected"),
    [
        ("a.json", lambda: b'{"a": ["b", {"c": "d"}], "e": 1}', list("abcde")),
        ("a.jsonl", lambda: b'{"a": 1}\n{"b": "c"}', list("abc")),
        ("a.toml", lambda: b'a = "b"\n[c]\nd = 1', list("abcd")),
        ("a.parquet", parquet, ["A", "callsign", "cycle", "name", "p", "sector", "t", "x"]),
        ("a.onnx", onnx, ["Neg", "batch", "experiment", "g", "lateral", "out", "seen"]),
    ],
)
def test_texts_are_found_and_replaced(name, make, expected):
    data = make()
    places = texts_in(name, data)
    found = {text_at(name, data, place) for place in places}
    assert set(expected) <= found
    for place in places:
        changed = with_text(name, data, place, "another")
        texts = sorted(text_at(name, changed, each) for each in texts_in(name, changed))
        rest = sorted(text_at(name, data, each) for each in places if each != place)
        assert texts == sorted([*rest, "another"])


def test_a_text_in_a_column_is_replaced_in_every_row():
    changed = with_text("a.parquet", parquet(), (("first",), ("callsign",)), "C")
    assert pq.read_table(pa.BufferReader(changed))["callsign"].to_pylist() == ["C", "B", "C"]
    changed = with_text("a.parquet", parquet(), (("metadata",), "sector", "name"), "y")
    metadata = pq.read_schema(pa.BufferReader(changed)).metadata
    assert json.loads(metadata[b"sector"]) == {"name": "y"}
