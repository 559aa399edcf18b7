"""Every setting, nested by package, with its default, unit and meaning where it stands."""

from __future__ import annotations

from dataclasses import dataclass, field

from mapmyworld.config.ranges import (
    Count,
    DepthCodec,
    FromZero,
    Grey,
    ImageCodec,
    Likely,
    Many,
    Positive,
    Probability,
    Quality,
    Seed,
    Share,
    Shift,
    Step,
    Unlikely,
    Whole,
)


@dataclass(frozen=True, slots=True)
class SensingConfig:
    """Settings of the plan, of frames and of nodes."""

    scan_topic: str = ""  # empty = chosen by the plan
    colour_topic: str = ""  # empty = chosen by the plan
    depth_topic: str = ""  # empty = chosen by the plan
    camera_info_topic: str = ""  # empty = chosen by the plan
    odometry_topic: str = ""  # empty = chosen by the plan; "tf" = from transforms; "none"
    base_frame: str = ""  # empty = chosen by the plan
    scan_mount: str = ""  # "x y z roll pitch yaw" of the laser on the base; empty = from tf
    camera_mount: str = ""  # the same for the camera's optical frame; empty = from tf
    odometry_offset: Shift = 0.0  # s added to the stamps of the odometry; 0 = by what is measured
    scan_offset: Shift = 0.0  # s added to the stamps of the laser
    camera_offset: Shift = 0.0  # s added to the stamps of the cameras
    imu_offset: Shift = 0.0  # s added to the stamps of the inertial sensor
    image_tolerance: FromZero = 0.02  # s between colour and depth of one frame
    frame_tolerance: FromZero = 0.05  # s between the sensors of one frame
    node_distance: FromZero = 0.1  # m of motion that makes a new node
    node_angle: FromZero = 0.1  # rad of rotation that makes a new node
    cloud_lowest: float = 0.2  # m above the base: the slice of a 3D lidar's points that is a scan
    cloud_highest: float = 2.0  # m above the base, of the same slice
    cloud_nearest: FromZero = 0.5  # m from a 3D lidar within which its points are the robot itself
    cloud_spacing: Positive = 0.1  # m between the points of a 3D lidar that a node keeps
    use_scans: bool = True  # whether laser scans are used
    use_images: bool = True  # whether camera images are used


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    """Settings of tracking by laser, and of aligning all scans in the end."""

    keyframe_distance: FromZero = 0.15  # m of motion after which a scan or image is a keyframe
    keyframe_angle: Positive = 0.2  # rad of rotation after which a scan or image is a keyframe
    contradiction: Positive = 4.0  # sigmas between odometry and match at which odometry is ignored
    least_overlap: Share = 0.55  # share of a scan that the submap explains, below which it searches
    search_distance: FromZero = 0.8  # m to each side that such a search covers
    search_angle: FromZero = 1.6  # rad to each side that such a search covers
    refine: bool = True  # whether all scans are aligned with each other after the graph is solved
    refine_distance: Positive = 0.3  # m of motion between scans that are aligned jointly in the end
    refine_angle: Positive = 0.3  # rad of rotation between scans that are aligned jointly
    refine_radius: Positive = 4.0  # m within which other visits' scans are aligned with each
    refine_revisits: Whole = 4  # revisits that each scan is aligned with, at most
    refine_references: Count = 2  # revisits of a place that shape the map; later ones follow


@dataclass(frozen=True, slots=True)
class RegistrationConfig:
    """Settings of aligning laser scans."""

    point_spacing: Positive = 0.04  # m between neighbouring points of a scan that are matched
    point_count: Count = 220  # points of a scan that are matched, about; more are thinned
    line_radius: Positive = 0.15  # m around a point within which its line is fitted
    range_max: Positive = 40.0  # m, farther returns are not matched
    residual_share: Positive = 0.25  # of the search for a line: so far off a point counts half
    range_sigma: Positive = 0.02  # m, standard deviation of a point about its line
    correlation: Positive = 4.0  # neighbouring points that together count as one


@dataclass(frozen=True, slots=True)
class PlacesConfig:
    """Settings of recognising places."""

    vocabulary: str = ""  # file of visual words, or a map that has some; empty = learned anew
    laser_spacing: Step = 1.0  # m of path between two scans that look for known places nearby
    laser_far_spacing: Step = 2.0  # m of path between two scans that look as far as drift goes
    laser_submap: Positive = 5.0  # m of path to each side that a submap covers
    laser_revisits: Whole = 3  # earlier revisits that each scan is compared with, at most


@dataclass(frozen=True, slots=True)
class GraphConfig:
    """Settings of optimisation and of believing closures."""

    iterations: Count = 300  # steps of Levenberg-Marquardt at most, per start
    tolerance: Positive = 1e-7  # relative decrease of the cost below which a solution stands
    robust: bool = True  # whether closures that contradict odometry and each other are rejected
    inlier_probability: Probability = 0.9999  # of a true constraint to pass a chi-square test
    consistency_probability: Probability = 0.999  # of two true closures to pass for consistent
    groups: bool = True  # whether closures that agree among themselves must fit the rest as well
    covariances: bool = True  # whether the uncertainty of every node is computed
    certify: bool = True  # whether it is proven, where possible, that the minimum is global


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Settings of the occupancy grid."""

    resolution: Positive = 0.05  # m, side of a cell of the grid
    range_max: Positive = 30.0  # m, beams are drawn up to here
    missing_range: FromZero = 0.0  # m that a beam without return is taken to have passed freely
    hit_probability: Likely = 0.7  # of being occupied, for a cell in which a beam ended
    miss_probability: Unlikely = 0.35  # of being occupied, for a cell which beams passed through
    clamp_probability: Likely = 0.97  # how confident a cell can become, of either


@dataclass(frozen=True, slots=True)
class ParticlesConfig:
    """Settings of FastSLAM."""

    count: Count = 30  # particles at most
    count_min: Count = 10  # particles at least; as many as `count` switches the adaptation off
    resolution: Positive = 0.05  # m, cells of the particles' maps
    range_max: Positive = 25.0  # m, end points farther away are not used
    beams: Count = 180  # end points of a scan at most
    beam_spacing: Positive = 0.03  # m between neighbouring end points
    step_distance: Positive = 0.15  # m of motion between two updates of the filter
    step_angle: Positive = 0.15  # rad of rotation between two updates of the filter
    resample_below: Share = 0.5  # share of effective particles at which the filter resamples
    kld_error: Positive = 0.15  # distance to the true posterior that sets the number of particles


@dataclass(frozen=True, slots=True)
class StorageConfig:
    """Settings of what map.db keeps, and how."""

    store_images: bool = True  # keep colour and depth images of the nodes
    image_codec: ImageCodec = "jpeg"  # "jpeg" or "png"; recorded JPEG files are kept as they are
    image_quality: Quality = 95  # JPEG quality, 1 to 100
    depth_codec: DepthCodec = "png"  # "png" (whole mm; recorded PNG is kept), or "float" (exact)


@dataclass(frozen=True, slots=True)
class LimitsConfig:
    """What files may claim."""

    chunk_mb: Count = 256  # MB of one chunk of a log; a chunk that claims more is damage
    image_megapixels: Count = 64  # million pixels of one image; one that claims more is damage
    unpacked_gb: Count = 64  # GB that a compressed log may unpack to


@dataclass(frozen=True, slots=True)
class VisualConfig:
    """Settings of all that is made of images."""

    cloud_voxel: Positive = 0.02  # m, edge of the cloud's voxels
    cloud_spacing: Positive = 0.25  # m or rad between the nodes whose images make the cloud
    depth_min: FromZero = 0.1  # m, nearer depth is ignored
    cloud_range: Positive = 5.0  # m, farther depth is not mapped
    cloud_views: Count = 2  # measurements within 5 cm that a voxel of the cloud needs
    feature_count: Many = 1000  # features kept of an image, spread over it
    fast_threshold: Grey = 7  # grey levels by which a corner stands out
    depth_max: Positive = 8.0  # m, farther depth gives no 3D point to a feature
    depth_sigma: Positive = 0.007  # 1/m, sigma of inverse depth: that of depth is this times z^2
    inlier_sigmas: Positive = 3.0  # a sighting agrees within so many standard deviations
    place_features: Count = 600  # features of a node's image for words and closures
    place_similarity: Share = 0.02  # cosine of two images' words, at least, for a candidate
    closure_inliers: Count = 25  # matches that agree on a pose or a closure, at least
    obstacle_lowest: float = 0.08  # m above the floor from which something is an obstacle
    obstacle_highest: float = 1.5  # m above the floor; what hangs higher is passed under
    grid_range: Positive = 5.0  # m to which a scan is made from depth
    mesh_voxel: Positive = 0.02  # m, edge of the mesh's voxels
    markers: str = ""  # markers to look for: "4x4_50", "6x6_250", "apriltag_36h11", ...; "" = none
    marker_length: FromZero = 0.0  # m, edge of a marker's black square; 0 = measured by depth


@dataclass(frozen=True, slots=True)
class LocalisationConfig:
    """Settings of localisation in a finished map."""

    spacing: Positive = 0.5  # m between the map's scans that new ones are matched with
    targets: Count = 4  # scans of the map that each new one is matched with


@dataclass(frozen=True, slots=True)
class Config:
    """All settings, by package."""

    threads: Whole = 0  # worker threads; 0, and covariances: as many as cores. Results are the same
    seed: Seed = 0  # of everything random
    sensing: SensingConfig = field(default_factory=SensingConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    places: PlacesConfig = field(default_factory=PlacesConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)
    particles: ParticlesConfig = field(default_factory=ParticlesConfig)
    storage: StorageConfig = field(default_factory=StorageConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    visual: VisualConfig = field(default_factory=VisualConfig)
    localisation: LocalisationConfig = field(default_factory=LocalisationConfig)
