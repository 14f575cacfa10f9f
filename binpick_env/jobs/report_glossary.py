"""The terms of a report, explained at its end; the site's glossary says more of each."""

import re
from html import escape

# Term as in the site's glossary, how a page writes it, and its meaning.
TERMS: tuple[tuple[str, str, str], ...] = (
    ("Attempt", r"\battempts?\b", "One execution of a grasp. It begins when the gripper leaves the pre-grasp."),
    (
        "Abstention",
        r"\babstentions?\b|\babstained\b",
        "A decision without an attempt: no_candidate (perception found no part), no_clear_approach (every grasp would "
        "touch something, or failed before) or ik_infeasible (the clear grasps are out of reach).",
    ),
    ("GSR (grasp success rate)", r"\bGSR\b", "Delivered parts divided by attempts."),
    ("DR (declutter rate)", r"\bDR\b", "Delivered parts divided by the parts that had settled in the bin."),
    (
        "Delivered",
        r"\bdelivered\b",
        "Released over the tray, at rest in it, and the only part that entered since the gripper last opened.",
    ),
    (
        "MPPH (mean picks per hour)",
        r"\bMPPH\b",
        "3600 · GSR / (sensing + computing + motion), with means over attempts in seconds. Sensing is a nominal 0.5 "
        "s for each image, computing is wall clock, motion is simulated. MPPH overlapped leaves out what is sensed and "
        "computed while the attempt before ends.",
    ),
    (
        "Outcome",
        r"\b(collided|missed|slipped|dropped|double|left[_ ](the )?bin|not[_ ]settled)\b",
        "How an attempt ended. Collided: the approach met a force over 60 N. Missed: the jaw closed on nothing. "
        "Slipped: lost in the lift. Dropped: lost on the way. Double: more than one part came along. Left the bin: a "
        "part lies outside of bin and tray. Not settled: nothing came to rest in the tray in time.",
    ),
    (
        "Put-back",
        r"\bput[_ -]back\b",
        "An attempt whose load was found to be more than one part and was put down in the bin again. It counts as an "
        "attempt without a delivery.",
    ),
    (
        "Push",
        r"\bpush(es)?\b",
        "Closed fingertips drag a part to where a grasp is clear. It is no attempt, but its time counts in MPPH.",
    ),
    ("2F", r"\b2F\b|two failures in a row", "Two failed attempts in a row, which end a bin."),
    (
        "Failure attribution",
        r"\bfailed at\b|\bby stage\b",
        "The first stage that went wrong. Segment: the group of points overlaps its part with an IoU under 0.5. "
        "Pose: the pose is wrong. Grasp: the jaw closed on nothing or lost the part. Physics: everything else.",
    ),
    (
        "Recognition",
        r"\brecognition\b",
        "Share of right poses among recognition trials: in each scene the three groups whose size is nearest to that "
        "of a whole part. No pose counts as a failure.",
    ),
    (
        "Pose accuracy",
        r"\bpose accuracy\b",
        "Share of all candidates whose pose is right for the part that owns most of their points.",
    ),
    (
        "Right pose",
        r"\b(right poses?|poses? right|poses? (is|are) (right|wrong))\b",
        "Within 10 % of the part's largest extent at its centre and within 5 degrees, modulo the part's symmetry.",
    ),
    (
        "Precision and recall of poses",
        r"\b(precision|recall)\b",
        "Precision: right poses divided by returned poses. Recall: parts at least half visible that have a right pose, "
        "divided by all parts at least half visible.",
    ),
    (
        "AP (average precision)",
        r"\bAP(25|50|75)?\b",
        "Of the segmentation of boundary points into parts: the mean over the IoU thresholds 0.50, 0.55 ... 0.90. AP50 "
        "and AP75 are taken at one threshold.",
    ),
    (
        "Visible fraction",
        r"\b(visib\w+|visible fraction)\b",
        "Visible pixels of a part divided by its pixels if it were rendered alone by the same camera without noise.",
    ),
    ("d_max", r"\bd_max\b", "Largest distance between two points of the part."),
    (
        "Zero-shot, family, own",
        r"\bzero-shot\b",
        "Zero-shot: neither the part's shape nor a part of its family was in any training. Own: the network was "
        "trained on the part. Family: it was trained on other parts of a generated part's family.",
    ),
    (
        "Oracle, gt_masks, learned",
        r"\b(oracle|gt_masks)\b",
        "What finds the parts. Oracle: the true poses of visible parts. gt_masks: poses are estimated in the true "
        "segments. Learned: everything from pixels.",
    ),
    (
        "Score",
        r"\bscore\b",
        "Of a pose: the probability that it is right, from 0 to 1. Of a grasp: the sum that ranks it.",
    ),
)
_TAG = re.compile(r"<[^>]*>")
_UNREAD = re.compile(r"<code>.*?</code>", re.DOTALL)  # commands and values of settings


def glossary(body: str) -> str:
    """Return a section with the meaning of every term that a page uses; empty if it uses none.

    Args:
        body: HTML of the page.
    """
    text = _TAG.sub(" ", _UNREAD.sub(" ", body))
    used = [(term, meaning) for term, pattern, meaning in TERMS if re.search(pattern, text, re.IGNORECASE)]
    if not used:
        return ""
    meanings = "".join(f"<dt>{escape(term)}</dt><dd>{escape(meaning)}</dd>" for term, meaning in used)
    shown = f"<details><summary>{len(used)} terms</summary><dl>{meanings}</dl></details>"
    return f"<h2>What the terms mean</h2><div class='card'>{shown}</div>"
