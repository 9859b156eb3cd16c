"""Structs of the contact models from the vectors that fields store, and back.

A contact model reads its constants and its history by name, from structs with a member for each slot
(see `contact.law.SLOTS`). Fields store a row of numbers: of a pair of materials, of
the law parameters of the scene, or of the history of a contact in one slot. The functions of this file
convert between the two; all names and indices are known when a kernel is compiled.
"""

from collections.abc import Iterable
from typing import Any

from granflow.contact.registry import ContactLaws
from granflow.device_functions import at_compile_time
from granflow.kernel_language import ti

# Constants


def build_constants(laws: ContactLaws) -> Any:
    """Device function (row of the pair constants, row of the law parameters) -> struct of slots, each of
    constants.

    A struct contains the pair constants and the parameters of its law by name.
    """
    parts: dict[str, list[tuple[str, Any, int]]] = {slot: [] for slot in laws.by_slot}
    for part, names_by_slot in ((_of_pair, laws.constant_names), (_of_law, laws.parameters)):
        names = [(slot, name) for slot, own in names_by_slot.items() for name in own]
        for k, (slot, name) in enumerate(names):
            parts[slot].append((name, part, k))
    slots = list(parts.items())

    @ti.func
    def constants_of(pair, parameters):
        return ti.Struct(
            {
                slot: ti.Struct({name: part(pair, parameters, k) for name, part, k in ti.static(own)})
                for slot, own in ti.static(slots)
            }
        )

    return constants_of


@ti.func
def _of_pair(pair, parameters, k: ti.template()):
    return pair[k]


@ti.func
def _of_law(pair, parameters, k: ti.template()):
    return parameters[k]


# History


def build_read_slots(laws: ContactLaws, read_vector: Any, stored: Iterable[str]) -> Any:
    """Device function (two indices) -> struct of slots, each a struct of the history fields of its model.

    read_vector:  device function (slot, two indices) -> vector of components of a slot
    stored:       slots with history; the structs of the others are empty
    """
    read = [
        (slot, build_slot_history(laws, slot), _stored_slot if slot in stored else _empty_slot)
        for slot in laws.by_slot
    ]

    @ti.func
    def read_slots(first, second):
        return ti.Struct(
            {
                slot: read_slot(history_of, read_vector, slot, first, second)
                for slot, history_of, read_slot in ti.static(read)
            }
        )

    return read_slots


@ti.func
def _stored_slot(history_of: ti.template(), read_vector: ti.template(), slot: ti.template(), first, second):
    return history_of(read_vector(slot, first, second))


@ti.func
def _empty_slot(history_of: ti.template(), read_vector: ti.template(), slot: ti.template(), first, second):
    return history_of(0)


def build_slot_history(laws: ContactLaws, slot: str) -> Any:
    """Device function (vector of components) -> struct of the history fields of a slot."""
    parts = []
    count = 0
    for each in laws.history[slot]:
        parts.append((each.name, number_at if each.size == 1 else vector_at, count))
        count += each.size

    @ti.func
    def slot_history(vector):
        return ti.Struct({name: part(vector, k) for name, part, k in ti.static(parts)})

    return slot_history


@ti.func
def number_at(vector, k: ti.template()):
    """Entry k of a vector or field."""
    return vector[k]


@ti.func
def vector_at(vector, k: ti.template()):
    """Entries k to k + 2 of a vector or field, as a vector."""
    return ti.Vector([vector[k], vector[k + 1], vector[k + 2]])


def build_slot_vector(laws: ContactLaws, slot: str) -> Any:
    """Device function (struct of the history fields of a slot) -> vector of components."""
    components = [
        (each.name, _number_of if each.size == 1 else _component_of, k)
        for each in laws.history[slot]
        for k in range(each.size)
    ]

    @ti.func
    def slot_vector(history):
        return ti.Vector([component(history, name, k) for name, component, k in ti.static(components)])

    return slot_vector


@ti.func
def _number_of(history, name: ti.template(), k: ti.template()):
    return member(history, name)


@ti.func
def _component_of(history, name: ti.template(), k: ti.template()):
    return member(history, name)[k]


@at_compile_time
def set_member(struct: Any, name: str, value: Any) -> None:
    """Assign to a member of a struct by a name that is known when the kernel is compiled."""
    getattr(struct, name)._assign(value)


@at_compile_time
def member(struct: Any, name: str) -> Any:
    """Member of a struct by a name that is known when the kernel is compiled."""
    return getattr(struct, name)
