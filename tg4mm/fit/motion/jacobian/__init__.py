"""The rendering Jacobian at rest by displacement and rotation of each Gaussian: JVP, VJP, Gauss-Newton product."""
