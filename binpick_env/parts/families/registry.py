"""The families by name, and their split into training and held-out ones.

The split was fixed before any training. The only gear, handle and spanner, all cups, and the only winged and finned
shapes are held out and have no near relative among the training families. ``cross_fitting`` and ``y_fitting`` do have
one, ``tee_fitting``, which is trained since trainings start from a network that knows the catalogue's tee. Results on
these two are therefore not zero-shot.
"""

from types import MappingProxyType

from binpick_env.parts.families import blocks, castings, fasteners, fittings, levers, plates, profiles, turned, wheels
from binpick_env.parts.families.drawing import Builder

_TRAINING: tuple[Builder, ...] = (
    turned.stepped_shaft,
    turned.slender_rod,
    turned.flanged_bushing,
    turned.thick_ring,
    turned.spool,
    turned.pulley,
    turned.nozzle,
    wheels.coupling,
    wheels.star_knob,
    wheels.handwheel,
    wheels.cam,
    fasteners.hex_bolt,
    fasteners.socket_screw,
    fasteners.hex_nut,
    fasteners.eye_bolt,
    fittings.pipe_elbow,
    fittings.reducer,
    fittings.tee_fitting,  # near the catalogue's tee, from whose network the trainings start
    fittings.pipe_flange,
    fittings.hose_barb,
    profiles.l_bracket,
    profiles.gusset_bracket,
    profiles.z_bracket,
    profiles.u_channel,
    profiles.hat_bracket,
    profiles.t_profile,
    profiles.square_tube,
    profiles.pipe_clamp_half,
    blocks.v_block,
    blocks.dovetail,
    blocks.wedge,
    blocks.manifold_block,
    plates.drilled_plate,
    plates.pocketed_plate,
    plates.hinge_leaf,
    plates.oval_flange,
    levers.connecting_rod,
    levers.rocker_lever,
    levers.crank_arm,
    castings.housing,
    castings.pillow_block,
    castings.clevis,
    castings.corner_bracket,
    castings.hook,
)
_HELD_OUT: tuple[Builder, ...] = (
    levers.spanner,  # slender and flat
    castings.handle,  # slender and bent
    wheels.spur_gear,  # round and toothed
    turned.piston,  # hollow
    turned.hollow_cap,  # hollow
    fittings.cross_fitting,  # branched
    fittings.y_fitting,  # branched
    fasteners.wing_nut,  # winged
    blocks.heat_sink,  # finned
)
TRAINING_FAMILIES: tuple[str, ...] = tuple(build.__name__ for build in _TRAINING)
HELD_OUT_FAMILIES: tuple[str, ...] = tuple(build.__name__ for build in _HELD_OUT)
FAMILIES = MappingProxyType({build.__name__: build for build in (*_TRAINING, *_HELD_OUT)})
