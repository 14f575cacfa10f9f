from .delivery import Delivery as Delivery
from .delivery import DeliveryEvent as DeliveryEvent
from .delivery import DeliveryJudge as DeliveryJudge
from .kinematic_motion import KinematicMotion as KinematicMotion
from .render import PicturePainter as PicturePainter
from .settle import SettleError as SettleError
from .settle import drop_and_settle as drop_and_settle
from .simulation import Simulation as Simulation
