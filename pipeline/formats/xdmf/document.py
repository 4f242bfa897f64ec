"""An XDMF file as a tree of elements, in which inclusions and references are followed.

Programs write a mesh once and point to it: by xi:include with an xpointer, or by the attribute Reference.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from pipeline.errors import shorten
from pipeline.formats.preflight import find_outside_name, find_refusal

_INCLUDE = "{http://www.w3.org/2001/XInclude}include"
_INCLUDES = (_INCLUDE, "{https://www.w3.org/2001/XInclude}include", "{http://www.w3.org/2003/XInclude}include")
_DEEPEST = 20  # references that lead to references; a circle ends here
_POINTER = re.compile(r"(xpointer|element)\(((?:[^()'\"]|'[^']*'|\"[^\"]*\"|\(\))*)\)")
_STEP = re.compile(r"(/{1,2})([\w.-]+|\*)((?:\[(?:[^\]'\"]|'[^']*'|\"[^\"]*\")*\])*)")
_PREDICATE = re.compile(r"\[((?:[^\]'\"]|'[^']*'|\"[^\"]*\")*)\]")
_EQUALS = re.compile(r"@([\w.:-]+)\s*=\s*(?:'([^']*)'|\"([^\"]*)\")$")
_TEXT = "text of another file"  # marks an element that stands for included text


class XdmfDocument:
    """The elements of a file and of the files that it includes; raises ValueError or OSError on what is wrong in it."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._trees: dict[Path, Element] = {}
        self._folders: dict[Element, Path] = {}
        self._targets: dict[tuple[Path, str], list[Element]] = {}
        self.root = self._parse(file)
        if self.root.tag != "Xdmf":
            raise ValueError(f"not an XDMF file: it begins with <{shorten(self.root.tag)}>")

    def get_children(self, element: Element, *tags: str) -> list[Element]:
        """Return the children with one of these tags (all if none are given), where inclusions are followed."""
        found = self._expand(element, 0)
        return [child for child in found if not tags or child.tag in tags]

    def get_child(self, element: Element, tag: str) -> Element | None:
        """Return the first child of that tag, None if there is none."""
        children = self.get_children(element, tag)
        return children[0] if children else None

    def get_text(self, element: Element) -> str:
        """Return the text of an element, with the text of files that it includes."""
        parts = [element.text or ""]
        for child in element:
            if child.tag in _INCLUDES:
                parts += [target.text or "" for target in self._include(child, 0) if target.tag == _TEXT]
            parts.append(child.tail or "")
        return "".join(parts)

    def get_folder(self, element: Element) -> Path:
        """Return the folder to which the file names in an element are relative."""
        return self._folders.get(element, self.file.parent)

    def find_file(self, element: Element, name: str) -> Path:
        """Return the file that an element names; raises ValueError if it lies outside the document's own folder."""
        folder = self.get_folder(element)
        own = self.file.parent.resolve()
        path = Path(name)
        if not path.is_absolute() and (fault := find_outside_name(name)):
            raise ValueError(fault)
        path = (path if path.is_absolute() else folder / path).resolve()
        if not path.is_relative_to(own):
            raise ValueError(f"it names a file outside its own folder ({shorten(name, 200)}); put it beside its files")
        if not path.is_file():
            raise FileNotFoundError(f"the file {shorten(name, 200)} that it names does not exist")
        return path

    def _parse(self, file: Path) -> Element:
        if file not in self._trees:
            if fault := find_refusal(file):
                raise ValueError(fault)
            self._trees[file] = ET.parse(file).getroot()
            if file.parent != self.file.parent:
                self._folders.update(dict.fromkeys(self._trees[file].iter(), file.parent))
        return self._trees[file]

    def _expand(self, element: Element, depth: int) -> list[Element]:
        """Return the children of an element; inclusions and references give way to their targets."""
        if depth > _DEEPEST:
            raise ValueError("its references lead in a circle")
        children = []
        for child in element:
            if child.tag in _INCLUDES:
                children += [self._follow(target, depth) for target in self._include(child, depth)]
            else:
                children.append(self._follow(child, depth))
        return children

    def _follow(self, element: Element, depth: int) -> Element:
        """Return the element to which the attribute Reference leads, or the element itself."""
        reference = element.get("Reference")
        if reference is None:
            return element
        if depth > _DEEPEST:
            raise ValueError("its references lead in a circle")
        path = (element.text or "").strip() if reference.upper() == "XML" else reference.strip()
        targets = self._find(self.file, path)
        if not targets:
            raise ValueError(f"its reference {shorten(path, 200)} leads nowhere")
        return self._follow(targets[0], depth + 1)

    def _include(self, element: Element, depth: int) -> list[Element]:
        """Return the elements that an xi:include stands for."""
        if depth > _DEEPEST:
            raise ValueError("its inclusions lead in a circle")
        href, pointer = element.get("href", ""), element.get("xpointer", "")
        file = self.find_file(element, href) if href else self.file
        if element.get("parse") == "text":
            text = Element(_TEXT)
            text.text = file.read_text(encoding="utf-8")
            return [text]
        if not pointer:
            root = self._parse(file)
            return list(root.iter("Grid"))[:1] if root.tag == "Xdmf" else [root]
        targets = self._find(file, pointer)
        if not targets:
            raise ValueError(f"its xpointer {shorten(pointer, 200)} leads nowhere")
        return targets

    def _find(self, file: Path, pointer: str) -> list[Element]:
        key = (file, pointer)
        if key not in self._targets:
            self._targets[key] = _find_elements(self._parse(file), pointer)
        return self._targets[key]


def _find_elements(root: Element, pointer: str) -> list[Element]:
    """Return the elements that an xpointer, or a path of XPath, selects below the root (which it may name)."""
    parts = _POINTER.findall(pointer) or [("xpointer", pointer)]
    for scheme, path in parts:
        found = _count_down(root, path) if scheme == "element" else _walk(root, path.strip())
        if found:
            return found
    return []


def _count_down(root: Element, path: str) -> list[Element]:
    """Return the element of the scheme element(): /1/4/2 is the second child of the fourth child of the root."""
    numbers = [int(part) for part in path.split("/") if part.strip()]
    element = root
    for number in numbers[1:]:
        if not 0 < number <= len(element):
            return []
        element = element[number - 1]
    return [element]


def _walk(root: Element, path: str) -> list[Element]:
    path = path if path.startswith("/") else f"//{path}"
    steps, end = [], 0
    for match in _STEP.finditer(path):
        if match.start() != end:
            break
        steps.append(match.groups())
        end = match.end()
    if end != len(path) or not steps:
        raise ValueError(
            f"its path {shorten(path, 200)} is not understood (it may have /, //, *, [n], [@name='value'])"
        )
    document = Element("document")
    document.append(root)
    elements = [document]
    for axis, tag, predicates in steps:
        parents = elements if axis == "/" else [inner for element in elements for inner in element.iter()]
        elements = []
        for parent in parents:
            candidates = [child for child in parent if tag in ("*", child.tag)]
            for predicate in _PREDICATE.findall(predicates):
                candidates = list(_filter(candidates, predicate.strip(), path))
            elements += candidates
        elements = list(dict.fromkeys(elements))
    return elements


def _filter(candidates: list[Element], predicate: str, path: str) -> Iterator[Element]:
    """Yield the candidates that meet a predicate: a position, an attribute's value or self::A or self::B."""
    if predicate.isdigit():
        yield from candidates[int(predicate) - 1 : int(predicate)] if int(predicate) else ()
        return
    if all(part.startswith("self::") for part in re.split(r"\s+or\s+", predicate)):
        tags = {part.removeprefix("self::") for part in re.split(r"\s+or\s+", predicate)}
        yield from (candidate for candidate in candidates if candidate.tag in tags)
        return
    match = _EQUALS.match(predicate)
    if match is None:
        raise ValueError(f"its path {shorten(path, 200)} is not understood ([{shorten(predicate)}])")
    value = match[2] if match[2] is not None else match[3]
    yield from (candidate for candidate in candidates if candidate.get(match[1]) == value)
