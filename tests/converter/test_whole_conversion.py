"""A conversion is whole, or the one before it stays."""

import pytest
from full_disk import full_disk

from myowarp.osim.bundle.bundle import SIDECARS, write
from myowarp.osim.convert.run import COMPLETE


def test_a_full_disk_leaves_the_conversion_before(tmp_path):
    """Though its first files would have had room; afterwards the new one is there, without old sidecars."""
    before = {"model.xml": b"old", "forces.json": b"old", "report.json": b"old"}
    after = {"meshes/a.obj": b"new", "model.xml": b"new", "model.mjb": 1000 * b"x", "report.json": b"new"}
    write(tmp_path, before)
    with pytest.raises(OSError, match=r"model\.mjb' cannot be written \(File too large\)"), full_disk(100):
        write(tmp_path, after, instead_of=(*COMPLETE, *SIDECARS))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before
    write(tmp_path, after, instead_of=(*COMPLETE, *SIDECARS))
    found = {str(path.relative_to(tmp_path)): path for path in tmp_path.rglob("*") if path.is_file()}
    assert {name: path.read_bytes() for name, path in found.items()} == after
