"""The preset `paper`: [TG4MM] as published. A space triplane, then one motion triplane for each timestep."""
