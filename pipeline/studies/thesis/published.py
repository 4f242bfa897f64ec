"""The numbers and statements that the seeds print, with their sources: data only. T is the thesis, W the web page.

The source of a derived number has its derivation. Tolerances are 1 % of a volume, one iteration, and 0 for counts.
"""

from dataclasses import dataclass

VOLUME_TOLERANCE = 0.01  # of the published volume: the thesis prints three to five digits of it


@dataclass(frozen=True)
class PublishedNumber:
    """A published number; `quantity` is a field of our_runs.RunOutcome, `less` a scene whose value is subtracted."""

    what: str
    printed: str
    value: float
    tolerance: float
    source: str
    scene: str
    variant: str
    quantity: str
    less: str = ""
    remark: str = ""


@dataclass(frozen=True)
class Statement:
    """A statement of the seeds in words; `test` names the function of verbal_claims that tests it."""

    says: str
    source: str
    test: str


@dataclass(frozen=True)
class Timing:
    """A row of T's tables 7.1 and 7.2; `variant` is our variant of the same method."""

    model: str
    scene: str
    variant: str
    nodes: str
    cells: int
    seconds: float
    images: int


@dataclass(frozen=True)
class FigureSet:
    """The figures of one scene of the thesis, and the iterations that they show of each variant."""

    scene: str
    title: str
    figures: str
    states: dict[str, tuple[int, ...]]
    states_are: str = "The iterations that the thesis shows."


@dataclass(frozen=True)
class Correction:
    """A fault in the seeds; `test` names the function of corrections.py that runs the printed formula, if any.

    `fails` and `holds` are templates for that function's numbers.
    """

    where: str
    printed: str
    correct: str
    test: str = ""
    fails: str = ""
    holds: str = ""


# a scene without a fitted factor is named like the calibrated one, with this ending
AS_PRINTED = "_as_printed"
SCENES = ("bar_small", "bar", "mushroom", "armadillo")
PLANAR_SCENE = "beam2d"
COUNTED = ("nodes", "cells", "iteration")  # quantities that are counts
THESIS_METHOD = "gram_schmidt"  # T 6.11; one solve a step


def _make_volume(what: str, printed: str, source: str, scene: str, variant: str, **more: str) -> PublishedNumber:
    value = float(printed)
    quantity = more.pop("quantity", "largest_volume")
    return PublishedNumber(what, printed, value, VOLUME_TOLERANCE * value, source, scene, variant, quantity, **more)


def _make_count(scene: str, what: str, quantity: str, value: int, source: str) -> PublishedNumber:
    return PublishedNumber(f"{scene}: {what}", f"{value}", value, 0.0, source, scene, "linear", quantity)


NUMBERS: tuple[PublishedNumber, ...] = (
    _make_count("bar", "nodes", "nodes", 81, "T 5.1"),
    _make_count("bar", "tetrahedra", "cells", 192, "T 5.1"),
    _make_volume("bar: volume of every tetrahedron [m3]", "1", "T 5.1.2", "bar", "linear", quantity="its_rest_volume"),
    _make_volume("bar, f = 20, linear: largest volume [m3]", "1.270", "T 7.1.2, 2.024 - 0.754", "bar_small", "linear"),
    _make_volume("bar, f = 40, linear: largest volume [m3]", "2.0245", "T 5.1.2", "bar", "linear",
                 remark="the factor was fitted to this number"),
    _make_volume("bar, linear: f = 40 minus f = 20 [m3]", "0.754", "T 7.1.2", "bar", "linear", less="bar_small"),
    _make_volume("bar, f = 20, corotational: largest volume [m3]", "1.27", "T 7.1.2, 1.45 - 0.18", "bar_small",
                 THESIS_METHOD,
                 remark="1.27 is the linear value; 0.18 may be a misprint of 0.28, which would give 1.17"),
    _make_volume("bar, f = 40, corotational: largest volume [m3]", "1.45", "T 7.1.2", "bar", THESIS_METHOD,
                 remark="with the factor it occurs in the first step, which uses rotations at rest: none is tested"),
    _make_volume("bar, corotational: f = 40 minus f = 20 [m3]", "0.18", "T 7.1.2", "bar", THESIS_METHOD,
                 less="bar_small", remark="it may be a misprint of 0.28"),
    _make_count("mushroom", "nodes", "nodes", 219, "T 5.2"),
    _make_count("mushroom", "tetrahedra", "cells", 656, "T 5.2"),
    _make_volume("mushroom, linear: largest volume ratio", "2.25", "T 5.2", "mushroom", "linear",
                 quantity="largest_ratio", remark="the factor was fitted to this number"),
    PublishedNumber("mushroom, linear: iteration of the largest", "the last (100)", 100, 1, "T 5.2", "mushroom",
                    "linear", "iteration"),
    _make_count("armadillo", "nodes", "nodes", 285, "T 5.3"),
    _make_count("armadillo", "tetrahedra", "cells", 787, "T 5.3"),
    _make_volume("armadillo, linear: largest volume ratio", "6.335", "T 5.3", "armadillo", "linear",
                 quantity="largest_ratio", remark="the factor was fitted to this number"),
    _make_volume("armadillo, linear: largest volume [m3]", "3.45e4", "T 5.3", "armadillo", "linear"),
    _make_volume("armadillo: volume of that tetrahedron at rest [m3]", "5446", "T 5.3, 3.45e4 / 6.335", "armadillo",
                 "linear", quantity="largest_rest_volume", remark="the scale 8.98 of our mesh was chosen for it"),
    PublishedNumber("armadillo, linear: iteration of the largest", "26", 26, 1, "T 5.3", "armadillo", "linear",
                    "iteration"),
)  # fmt: skip

STATEMENTS: tuple[Statement, ...] = (
    Statement("at f = 20 both methods give very similar results", "T 7.1.1", "small_bar_alike"),
    Statement("at f = 40 the linear bar grows more than the corotational one", "T 7.1.2", "bar_grows_less"),
    Statement("both maxima of f = 40 are in the same tetrahedron", "T 7.1.2", "same_cell"),
    Statement("the tetrahedra at the free end grow most", "T 5.1.2", "free_end"),
    Statement("the growth is largest in the first iterations", "T 5.1.2", "first_iterations"),
    Statement("the bar oscillates until it stops", "T 5.1.1", "bar_stops"),
    Statement("the corotational mushroom's oscillations of volume are infinitesimal beside the linear ones", "T 7.2",
              "mushroom_infinitesimal"),
    Statement("the corotational armadillo's growth is small beside the linear one", "T 7.3", "armadillo_small"),
    Statement("backward Euler is unconditionally stable", "T 4.4", "unconditionally_stable"),
    Statement("the linear method is fast enough for real time", "T 7.4", "linear_real_time"),
    Statement("the corotational method is not", "T 7.4", "corotational_real_time"),
)  # fmt: skip

TIMINGS: tuple[Timing, ...] = (
    Timing("bar", "bar", "linear", "81", 192, 0.002688, 372),
    Timing("mushroom", "mushroom", "linear", "192 (misprint of 219)", 656, 0.009096, 109),
    Timing("armadillo", "armadillo", "linear", "285", 787, 0.009873, 101),
    Timing("bar", "bar", THESIS_METHOD, "81", 192, 0.083354, 12),
    Timing("mushroom", "mushroom", THESIS_METHOD, "219", 656, 0.37631, 2),
    Timing("armadillo", "armadillo", THESIS_METHOD, "285", 787, 0.454307, 2),
)

FIGURES: tuple[FigureSet, ...] = (
    FigureSet("bar_small", "Bar, f = 20", "7.1, 7.2, 7.3 (linear), 7.4 (corotational)",
              {"linear": (1, 4, 8, 12), THESIS_METHOD: (1, 4, 8, 12)},
              "Iterations of our choice: the thesis names none."),
    FigureSet("bar", "Bar, f = 40", "5.4, 7.5, 7.6 (linear), 7.7 (corotational)",
              {"linear": (1, 3, 8, 35), THESIS_METHOD: (1, 3, 8, 35)},
              "The iterations that the thesis shows of the corotational bar, for both."),
    FigureSet("mushroom", "Mushroom", "5.7, 7.8, 7.9, 7.10 (linear), 7.11 (corotational)",
              {"linear": (1, 20, 40, 60), THESIS_METHOD: (1, 20, 50, 70)}),
    FigureSet("armadillo", "Armadillo", "5.10, 7.12, 7.13, 7.14 (linear), 7.15 (corotational)",
              {"linear": (1, 16, 26, 40, 50, 63), THESIS_METHOD: (1, 15, 30, 45, 60, 75)}),
)  # fmt: skip

CORRECTIONS: tuple[Correction, ...] = (
    Correction("T 3.5-3.13", "“Green-Cauchy” for the linear tensor; 3.10-3.12 without 1/2",
               "infinitesimal (Cauchy) strain; Green-Lagrange has 1/2"),
    Correction("T 3.20-3.22", "ε_xx = sum of σ_xx^(k)", "ε_xx = sum of ε_xx^(k)"),
    Correction("T 3.37", "initial condition for u only", "also for ∂u/∂t"),
    Correction("T 4.5", "ξ, η, μ in [0, 1]", "ξ, η, μ ≥ 0 and ξ + η + μ ≤ 1"),
    Correction("T 4.9-4.12", "f~(x~) := f(φ(x)); J of the wrong map",
               "f(x) = f~(φ(x)); J = ∂x/∂ξ, ∇f = J^-T ∇~f~"),
    Correction("T 4.30, (*)_2, third sum", "∂N_i/∂x ∂N_j/∂x", "∂N_i/∂z ∂N_j/∂y", "third_sum",
               "K_e is asymmetric by {asymmetry:.0%} of its norm, has a kernel of {kernel:.0f} instead of 6, its "
               "symmetric part the eigenvalue {lowest:+.1%} of the largest; rotations by 1 rad about x, y, z cause "
               "forces of {about_x:.2g}, {about_y:.2g}, {about_z:.1g} E h²",
               "asymmetric by {asymmetry:.1g}, kernel {kernel:.0f}, lowest eigenvalue {lowest:.1g}, "
               "forces {about_x:.1g}, {about_y:.1g}, {about_z:.1g} E h²"),
    Correction("T 4.32, left factor, row 3", "(0, ∂N_i/∂z, ∂N_i/∂x)", "(0, ∂N_i/∂y, ∂N_i/∂x)", "left_factor",
               "K_e is asymmetric by {asymmetry:.0%} of its norm, its symmetric part has the eigenvalue {lowest:+.1%} "
               "of the largest; the bar of f = 20 moves by {travel:.3g} m within 100 steps",
               "asymmetric by {asymmetry:.1g}, lowest eigenvalue {lowest:.1g}; within 100 steps at most "
               "{travel:.3g} m"),
    Correction("T 4.33", "prefactor E/((1+ν)(1-2ν)) once more; no volume",
               "without it; times V_e; c = G = E/(2(1+ν))"),
    Correction("T 4.47, 4.48", "M v_n - Δt (f - K u_n)", "M v_n + Δt (f - K u_n)", "load_sign",
               "the bar's first mode grows {growth:.4f}-fold a step (in theory 1 + z/√(1+z²) = {theory:.4f}); the bar "
               "of f = 20 moves by {travel:.2g} m within 100 steps, and gravity lifts it: {rise:+.2g} m in step 1",
               "the mode shrinks {growth:.4f}-fold a step (1/√(1+z²) = {theory:.4f}); at most {travel:.3g} m, "
               "gravity: {rise:+.2g} m in step 1"),
    Correction("T 6.2", "“exactly the same forces as 6.1”", "equal only for R = I"),
    Correction("T 6.6", "unitary polar factor", "a real F with det F < 0 gives a reflection: remove it"),
    Correction("T 6.7-6.10", "p = A x, with vertices 0..3 against 1..4", "p - p_0 = A (x - x_0)"),
    Correction("T 6.11", "Gram-Schmidt satisfies A = R P",
               "it is QR: R^T A is triangular; NaN for a_0 = 0 or a_1 ∥ a_0"),
    Correction("T 6.12-6.16", "f - K'(u + x) - f_0", "f - K'(u + x) + f_0", "rest_force",
               "at rest, without loads, the residual is {share:.6f} of -2 K x: {residual:.2g} N; step 1 moves the "
               "resting bar by {jump:.2g} m",
               "residual {residual:.1g} N, step 1 moves it by {jump:.1g} m"),
    Correction("T 7.1.2", "1.45 is “0.18 more” than at f = 20", "then that is the linear value; probably 0.28"),
    Correction("T table 7.1", "mushroom of 192 nodes", "219"),
    Correction("W", "S symmetric; λ in 2D not named; time integration is a second “2.”",
               "S symmetric positive semidefinite; plane strain; 5."),
)  # fmt: skip
