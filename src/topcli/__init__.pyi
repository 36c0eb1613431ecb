from topcli.analysis.motion import Motion as Motion
from topcli.analysis.trajectory import Trajectory as Trajectory
from topcli.contracts import Top as Top
from topcli.figures.catalogue import figure as figure
from topcli.runs.simulate import simulate as simulate
from topcli.runs.step_map import step as step
from topcli.schemes.own_tops import top as top
from topcli.schemes.registry import scheme as scheme
from topcli.show.report import analyse as analyse
from topcli.show.report import check as check
from topcli.show.report import claims as claims
from topcli.show.report import compare as compare
from topcli.show.report import frequencies as frequencies
from topcli.show.report import integrability as integrability
from topcli.show.report import lax as lax
from topcli.show.report import lyapunov as lyapunov
from topcli.show.report import motion as motion
from topcli.show.report import order as order
from topcli.show.report import roundoff as roundoff
from topcli.show.report import stress as stress
from topcli.show.results import run as run
from topcli.show.results import sweep as sweep
from topcli.studies.stress.cases import case as case
from topcli.sweeps.measures import measure as measure

__version__: str
