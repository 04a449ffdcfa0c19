"""What controllers are designed with: gains, margins, filters, maps from observations to states, paths, symbols."""
