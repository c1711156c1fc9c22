# The nodes in a full ROS 2 installation: built with colcon, beside the tools of ROS.
# docker build --file docker/ros.Dockerfile --tag armimp:ros .
# A tag can be moved; SECURITY.md says how to pin it by its digest.
ARG BASE=ros:jazzy-ros-base
FROM ${BASE}

WORKDIR /opt/armimp/src
COPY ros2_ws/src ros2_ws/src
COPY docker/install_system.sh docker/
RUN docker/install_system.sh

RUN useradd --create-home --uid 10001 armimp \
    && install --directory --owner armimp /results \
    && chown --recursive armimp /opt/armimp
USER 10001

COPY --chown=armimp requirements.txt ./
COPY --chown=armimp docker/install_wheels.sh docker/
RUN docker/install_wheels.sh --beside-ros

COPY --chown=armimp . .
RUN docker/install_packages.sh --beside-ros

# Compiles the numerical code, and shows that the image works.
RUN docker/entrypoint.sh armimp run --duration 10 --out /tmp/trial && rm -r /tmp/trial

WORKDIR /results
ENTRYPOINT ["/opt/armimp/src/docker/entrypoint.sh"]
CMD ["armimp", "run", "--out", "/results/run"]
