"""Published figures that stand beside ours: the paper's (Gao et al., CoRL 2021, Tables 2-4), and later."""

#: Accuracy over 100 objects, %.
RECOGNITION = {"V": 94.8, "A": 98.3, "T": 72.4, "VA": 99.5, "VT": 97.2, "AT": 99.0, "VAT": 99.8}
#: Accuracy over 1,000 objects, %, of the ObjectFolder Benchmark (Gao et al., CVPR 2023).
MATERIALS = {"V": 92.3, "A": 95.8, "T": 75.9, "VAT": 96.6}
#: Mean average precision, theirs and that of their CCA; seen objects.
RETRIEVAL = {
    "V->A": (0.90, 0.57),
    "V->T": (0.50, 0.24),
    "A->V": (0.92, 0.59),
    "A->T": (0.55, 0.31),
    "T->V": (0.48, 0.29),
    "T->A": (0.64, 0.33),
}
#: Mean average precision of the best method of the ObjectFolder Benchmark (Gao et al., CVPR 2023), 200 unseen
#: objects of 1,000.
UNSEEN_RETRIEVAL = {
    "V->A": 0.307,
    "V->T": 0.124,
    "A->V": 0.310,
    "A->T": 0.090,
    "T->V": 0.138,
    "T->A": 0.154,
}
#: IoU, Chamfer-L1, normal consistency; seen objects. Touches are not in the paper.
RECONSTRUCTION: dict[str, tuple[float, ...] | None] = {
    "average_shape": (0.0675, 0.1067, 0.6312),
    "V": (0.8809, 0.0046, 0.9522),
    "A": (0.8729, 0.0048, 0.9504),
    "T": None,
    "VA": (0.8906, 0.0043, 0.9535),
}
REACH = "100"  #: success with each of three objects, %; the paper does not say when
