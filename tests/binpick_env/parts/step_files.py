"""STEP files (ISO 10303-21, AP214) of polyhedra, written by hand so that the tests need no CAD program."""

from collections.abc import Callable, Sequence

import numpy as np
import trimesh

_HEADER = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('part.step','2026-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
"""
_LENGTHS = {"mm": "SI_UNIT(.MILLI.,.METRE.)", "m": "SI_UNIT($,.METRE.)"}


def step_text(solids: Sequence[trimesh.Trimesh], unit: str = "mm") -> str:
    """Return a STEP file of one product with a solid of plane triangles for each mesh.

    Args:
        solids: Closed meshes in the file's unit.
        unit: "mm", "m" or "inch".
    """
    lines: list[str] = []

    def add(entity: str) -> str:
        lines.append(f"#{len(lines) + 1}={entity};")
        return f"#{len(lines)}"

    def refs(names: Sequence[str]) -> str:
        return f"({','.join(names)})"

    application = add("APPLICATION_CONTEXT('automotive design')")
    add(f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,{application})")
    product_context = add(f"PRODUCT_CONTEXT('',{application},'mechanical')")
    product = add(f"PRODUCT('part','part','',({product_context}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    definition_context = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{application},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',{formation},{definition_context})")
    shape = add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    if unit == "inch":
        metric = add("(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.))")
        measure = add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),{metric})")
        exponents = add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
        length = add(f"(CONVERSION_BASED_UNIT('INCH',{measure}) LENGTH_UNIT() NAMED_UNIT({exponents}))")
    else:
        length = add(f"(LENGTH_UNIT() NAMED_UNIT(*) {_LENGTHS[unit]})")
    angle = add("(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.))")
    solid_angle = add("(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT())")
    uncertainty = add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-7),{length},'distance_accuracy_value','')")
    context = add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3) "
        f"GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({uncertainty})) "
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid_angle})) REPRESENTATION_CONTEXT('',''))"
    )
    bodies = [_brep(solid, add) for solid in solids]
    body = add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',{refs(bodies)},{context})")
    add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{body})")
    return _HEADER + "\n".join(lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"


def _brep(solid: trimesh.Trimesh, add: Callable[[str], str]) -> str:
    """Add a solid bounded by plane triangles; return its reference."""

    def triple(kind: str, values: np.ndarray) -> str:
        return add(f"{kind}('',({','.join(f'{x:.9E}' for x in values)}))")

    vertices = np.asarray(solid.vertices)
    points = [triple("CARTESIAN_POINT", vertex) for vertex in vertices]
    corners = [add(f"VERTEX_POINT('',{point})") for point in points]
    edges: dict[tuple[int, int], str] = {}
    faces = []
    for face, normal in zip(np.asarray(solid.faces), np.asarray(solid.face_normals), strict=True):
        oriented = []
        for a, b in zip(face, np.roll(face, -1), strict=True):
            if (b, a) not in edges and (a, b) not in edges:
                vector = add(f"VECTOR('',{triple('DIRECTION', vertices[b] - vertices[a])},1.)")
                line = add(f"LINE('',{points[a]},{vector})")
                edges[a, b] = add(f"EDGE_CURVE('',{corners[a]},{corners[b]},{line},.T.)")
            forward = (a, b) in edges
            edge = edges[(a, b) if forward else (b, a)]
            oriented.append(add(f"ORIENTED_EDGE('',*,*,{edge},{'.T.' if forward else '.F.'})"))
        along = triple("DIRECTION", vertices[face[1]] - vertices[face[0]])
        placement = add(f"AXIS2_PLACEMENT_3D('',{points[face[0]]},{triple('DIRECTION', normal)},{along})")
        plane = add(f"PLANE('',{placement})")
        loop = add(f"EDGE_LOOP('',({','.join(oriented)}))")
        bound = add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        faces.append(add(f"ADVANCED_FACE('',({bound}),{plane},.T.)"))
    shell = add(f"CLOSED_SHELL('',({','.join(faces)}))")
    return add(f"MANIFOLD_SOLID_BREP('',{shell})")
