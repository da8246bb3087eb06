"""Speed of plant, controllers and environments: ``edmsim bench``."""
