from topcli.analysis.motion import Motion as Motion
from topcli.analysis.trajectory import Trajectory as Trajectory
from topcli.cli.running import motion as motion
from topcli.cli.running import run as run
from topcli.cli.running import sweep as sweep
from topcli.contracts import Top as Top
from topcli.figures.catalogue import figure as figure
from topcli.paper.claims import claims as claims
from topcli.runs.simulate import simulate as simulate
from topcli.runs.step_map import step as step
from topcli.schemes.registry import scheme as scheme
from topcli.studies.analyse import analyse as analyse
from topcli.studies.bench import bench as bench
from topcli.studies.check import check as check
from topcli.studies.compare import compare as compare
from topcli.studies.frequencies import frequencies as frequencies
from topcli.studies.integrability import integrability as integrability
from topcli.studies.lax import lax as lax
from topcli.studies.lyapunov import lyapunov as lyapunov
from topcli.studies.order import order as order
from topcli.studies.roundoff import roundoff as roundoff
from topcli.studies.stress import stress as stress
from topcli.sweeps.measures import measure as measure
from topcli.tops.own import top as top

__version__: str
STUDIES: dict[str, tuple[str, str]]
