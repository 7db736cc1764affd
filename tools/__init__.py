"""What made the files that ship: emulators, policies, motions, meshes, pictures. Run from the root:

python -m tools.train_shipped pendulum 50
"""
