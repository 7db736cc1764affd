import neuroanimator.codegen.jax_settings  # noqa: F401 (before anything is computed)
