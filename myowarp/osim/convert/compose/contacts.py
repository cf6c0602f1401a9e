"""Contact forces in terms of the converted model: the sidecar `contacts.json`."""

from myowarp.osim.bundle.contacts import DocumentContacts, SurfacePair
from myowarp.osim.convert.compose.geometry import Build
from myowarp.osim.document.contacts import contact_pairs
from myowarp.osim.document.model import Model, Note


def document_contacts(build: Build, model: Model) -> DocumentContacts | None:
    """Return what touches what in a document; None: nothing does, or a force names no geometry of the model.

    Args:
        build: The build; its bodies have the frames of the document's.
        model: The document.
    """
    try:
        pairs = contact_pairs(model)
    except ValueError as error:
        build.notes.append(Note("/contactgeometryset", str(error)))
        return None
    found = tuple(SurfacePair.of(pair, lambda name: build.bodies[name].name) for pair in pairs)
    return DocumentContacts(found) if found else None
