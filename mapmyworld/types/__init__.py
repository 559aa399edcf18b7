"""The values that flow through the library: frozen dataclasses of read-only arrays."""

from mapmyworld.types.constraints import (
    CLOSURES,
    OF_ONE_NODE,
    TRUSTED,
    Constraint,
    ConstraintKind,
    Judged,
    Poses,
    Registration,
)
from mapmyworld.types.frames import (
    CameraModel,
    Features,
    Frame,
    ImuSample,
    Node,
    NodeData,
    RgbdImage,
    Scan,
    TrackedFrames,
    first_nodes,
)
from mapmyworld.types.log_info import LogInfo, TopicInfo, topics_of
from mapmyworld.types.maps import Mesh, OccupancyGrid, PointCloud, Trajectory
from mapmyworld.types.messages import (
    CameraInfoMessage,
    GpsMessage,
    ImageMessage,
    ImuMessage,
    LaserScanMessage,
    Message,
    MessageKind,
    OdometryMessage,
    PointCloudMessage,
    PoseMessage,
    RawMessage,
    TextMessage,
    TransformsMessage,
    TransformStamped,
)
from mapmyworld.types.pose_graph import Edges, PoseGraph, Priors, Sightings, no_priors, no_sightings
from mapmyworld.types.seams import LogSource, MapStore, Progress
from mapmyworld.types.sources import (
    RELOCALISED,
    CameraTracking,
    CorrectedOdometry,
    Given,
    ImageMatch,
    LaserTracking,
    Marker,
    Odometry,
    Particles,
    Person,
    ScanMatch,
    Source,
)
from mapmyworld.types.verdicts import Judge, Verdict, Why
