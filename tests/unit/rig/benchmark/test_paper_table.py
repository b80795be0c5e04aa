"""The kept results of trained networks as the paper's Table II."""

from rig.benchmark.segmentation import table_two, trained_models


def test_table_two_has_a_row_per_network_and_fold_with_training_settings() -> None:
    table = table_two()
    rows = {(row[0], row[1]): row for row in table.rows}
    assert len(rows) == 12
    assert "SIMULATED" in table.title
    for kept in trained_models():
        row = rows[kept["title"], kept["fold"]]
        width, height = kept["size_px"]
        assert row[2].startswith(f"{kept['dice']:.3f}")
        assert f"{width}x{height} px, {kept['images']['train']} x {kept['epochs']}" in row[5]
