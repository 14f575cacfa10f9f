"""The tessellation of STEP files by OpenCASCADE as a program of its own: it prints, and may end its process."""


def main(source: str, target: str, deflection_mm: str, angle: str) -> None:
    """Write the solids of a STEP file to a GLB file, in metres."""
    import cascadio

    code = cascadio.step_to_glb(source, target, float(deflection_mm), float(angle))
    if code != 0:
        raise SystemExit(f"OpenCASCADE cannot read it (code {code})")
