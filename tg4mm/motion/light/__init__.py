"""Light that changes as things move: gloss, shadows and reflections, told apart from motion and magnified with it."""
