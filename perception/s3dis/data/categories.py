"""The 13 categories of S3DIS in their official order (Armeni et al., CVPR 2016): an index is a semantic label."""

CATEGORIES = (
    "ceiling",
    "floor",
    "wall",
    "beam",
    "column",
    "window",
    "door",
    "table",
    "chair",
    "sofa",
    "bookcase",
    "board",
    "clutter",
)
CLUTTER = CATEGORIES.index("clutter")
SCORED = CATEGORIES[:CLUTTER]  # the twelve categories of the paper's Table 1
READ_AS = {"stairs": "clutter"}  # names in the raw tree that are no categories, as PointNet's and SGPN's code read them
AREAS = (1, 2, 3, 4, 5, 6)
TEST_AREA = 5
