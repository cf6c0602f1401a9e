"""Resources of kernels on a GPU, read from their machine code: an ELF file with a section for each.

The format of the notes is that of `cuobjdump --dump-elf`; NVIDIA's "CUDA Binary Utilities" names them.
"""

import re
import struct
from pathlib import Path
from typing import NamedTuple

INSTRUCTION = 16  # bytes, since compute capability 7.0
NOTES, CODE = ".nv.info", ".text."
REGISTERS, STACK = 0x2F, 0x12  # EIATTR_REGCOUNT, EIATTR_MIN_STACK_SIZE
SIZED = 0x04  # a note with its size, then its value; the others have 2 bytes


class Need(NamedTuple):
    """Registers of a thread, its stack [bytes], and instructions of the kernel."""

    registers: int
    stack: int
    instructions: int

    def or_more(self, other: "Need") -> "Need":
        """Return the larger of each."""
        return Need(*map(max, zip(self, other, strict=True)))


def needs(cubin: Path) -> dict[str, Need]:
    """Return what each kernel of a file needs, by name, without what tells its variants apart."""
    binary = cubin.read_bytes()
    sections = _sections(binary)
    names = _symbols(binary, sections)
    notes = {REGISTERS: dict[str, int](), STACK: dict[str, int]()}
    for kind, symbol, value in _notes(sections[NOTES][0]):
        if kind in notes:
            notes[kind][names[symbol]] = value
    found: dict[str, Need] = {}
    for section, (code, _) in sections.items():
        if section.startswith(CODE):
            kernel = section.removeprefix(CODE)
            need = Need(notes[REGISTERS][kernel], notes[STACK][kernel], len(code) // INSTRUCTION)
            name = _plain(kernel)
            found[name] = need.or_more(found.get(name, need))
    return found


def _plain(kernel: str) -> str:
    """Return a kernel's name as it is in its source."""
    return re.sub(r"(__locals__.*)?_[0-9a-f]{8,}_cuda_kernel_(forward|backward)$", "", kernel)


def _sections(binary: bytes) -> dict[str, tuple[bytes, int]]:
    """Return the content of each section of a 64-bit ELF file, and its entry size."""
    start, size, number, strings = (
        *struct.unpack_from("<Q", binary, 40),
        *struct.unpack_from("<HHH", binary, 58),
    )
    headers = [struct.unpack_from("<IIQQQQIIQQ", binary, start + i * size) for i in range(number)]
    empty = 8  # a section without content in the file
    contents = [b"" if h[1] == empty else binary[h[4] : h[4] + h[5]] for h in headers]
    return {
        _string(contents[strings], header[0]): (content, header[9])
        for header, content in zip(headers, contents, strict=True)
    }


def _symbols(binary: bytes, sections: dict[str, tuple[bytes, int]]) -> list[str]:
    """Return the names of all symbols."""
    table, size = sections[".symtab"]
    offsets = (struct.unpack_from("<I", table, i)[0] for i in range(0, len(table), size))
    return [_string(sections[".strtab"][0], offset) for offset in offsets]


def _notes(content: bytes) -> list[tuple[int, int, int]]:
    """Return kind, symbol and value of the notes that have a symbol and a value."""
    found, at = [], 0
    while at < len(content):
        form, kind, size = struct.unpack_from("<BBH", content, at)
        at += 4
        if form == SIZED:
            if size == 8:
                found.append((kind, *struct.unpack_from("<II", content, at)))
            at += size
    return found


def _string(table: bytes, offset: int) -> str:
    """Return a string that ends with a zero."""
    return table[offset : table.index(b"\0", offset)].decode()
