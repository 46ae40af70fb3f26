"""The process behind one environment of an `EpisodeVectorEnv`: ``python -m lerobot_buds.envs.worker FD``.

It reads ``(command, argument)`` from the inherited pipe and answers ``(error text or None, result)``, until the pipe
closes.
"""

import sys
from multiprocessing.connection import Connection

from lerobot_buds.core import SimulatorError

from .robosuite_env import RobosuiteEnv
from .vector_env import run_command


def serve(connection: Connection) -> None:
    """Serves one environment; its settings come with the first command, ``open``, which is not answered."""
    _, settings = connection.recv()
    env = RobosuiteEnv(settings)
    try:
        while True:
            command, argument = connection.recv()
            try:
                connection.send((None, run_command(env, command, argument)))
            except SimulatorError as error:
                connection.send((str(error), None))
    except (EOFError, BrokenPipeError, ConnectionResetError, KeyboardInterrupt):
        pass  # the parent is done with this environment
    finally:
        env.close()


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
