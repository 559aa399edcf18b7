"""Every setting, nested by package, with its default, unit and meaning where it stands."""

from __future__ import annotations

from dataclasses import dataclass, field

from mapmyworld.config.graph_settings import GraphConfig
from mapmyworld.config.limits_settings import LimitsConfig
from mapmyworld.config.localisation_settings import LocalisationConfig
from mapmyworld.config.mapping_settings import MappingConfig
from mapmyworld.config.odometry_settings import OdometryConfig
from mapmyworld.config.particles_settings import ParticlesConfig
from mapmyworld.config.places_settings import PlacesConfig
from mapmyworld.config.ranges import Seed, Whole
from mapmyworld.config.registration_settings import RegistrationConfig
from mapmyworld.config.sensing_settings import SensingConfig
from mapmyworld.config.storage_settings import StorageConfig
from mapmyworld.config.visual_settings import VisualConfig


@dataclass(frozen=True, slots=True)
class Config:
    """All settings, by package."""

    threads: Whole = 0  # worker threads; 0 = as many as cores. Results do not depend on it
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


__all__ = [
    "Config",
    "GraphConfig",
    "LimitsConfig",
    "LocalisationConfig",
    "MappingConfig",
    "OdometryConfig",
    "ParticlesConfig",
    "PlacesConfig",
    "RegistrationConfig",
    "SensingConfig",
    "StorageConfig",
    "VisualConfig",
]
