"""The controller node: ROS around :class:`armimp_control.experiment.Experiment`."""

from __future__ import annotations

import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from armimp_common import contract, qos
from armimp_common.channels import (
    CommandPublisher,
    JointStatePublisher,
    JointStateSubscription,
    wait_until_matched,
)
from armimp_common.diagnostics import trial_status_message
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.lifecycle import reported
from armimp_common.parameters import declare, guard, load
from armimp_common.spin import run_node
from armimp_common.trial_status import TrialStatus
from armimp_control.experiment import Experiment
from armimp_control.parameters import ControllerParameters
from armimp_control.safety import Watchdog

_MATCH_TIMEOUT = 10.0
_WATCHDOG_PERIOD = 0.005


class ImbicControllerNode(LifecycleNode):
    """Answers each sample with one command and one perturbation message."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(contract.CONTROLLER_NODE, **kwargs)
        self.transition_error = ""
        self._active = False
        self._experiment: Experiment | None = None
        declare(self, ControllerParameters)
        guard(self, lambda: "a trial is running" if self._active else None)

    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters and the stability of the loop; make the topics."""
        parameters = self._settings = load(self, ControllerParameters)
        names = parameters.joints
        for warning in self._prepare().margins.warnings:
            self.get_logger().warning(warning)
        self._commands = CommandPublisher(self, contract.COMMANDS, len(names))
        self._perturbation = JointStatePublisher(self, contract.PERTURBATION, names, "effort")
        self._trial = self.create_publisher(DiagnosticStatus, contract.TRIAL, qos.LATCHED)
        self._joint_states = JointStateSubscription(
            self,
            contract.JOINT_STATES,
            names,
            "position",
            self._on_position,
            on_malformed=self._on_malformed,
        )
        self._torque_sensors = JointStateSubscription(
            self,
            contract.TORQUE_SENSORS,
            names,
            "effort",
            self._on_torque,
            on_malformed=self._on_malformed,
        )
        self._timer = self.create_timer(_WATCHDOG_PERIOD, self._on_watchdog, autostart=False)
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the other end, then answer samples."""
        lonely = wait_until_matched(
            self,
            publishers=[self._commands],
            subscriptions=[self._joint_states, self._torque_sensors],
            timeout_s=_MATCH_TIMEOUT,
        )
        if lonely:
            raise GraphError(f"nobody at the other end of {', '.join(lonely)}")
        if self._experiment is None:
            self._prepare()
        safety = self._settings.safety
        self._watchdog = Watchdog(self._settings.safety_config(), period=safety.slowest_tick)
        self._active = True
        self._timer.reset()
        return super().on_activate(state)

    @reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take torque away; the next activation starts a new experiment."""
        self._stop("the controller was deactivated")
        self._experiment = None
        return super().on_deactivate(state)

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything, so that new parameters can be used."""
        self.destroy_timer(self._timer)
        for channel in (self._joint_states, self._torque_sensors):
            self.destroy_subscription(channel.subscription)
        for publisher in (self._commands.publisher, self._perturbation.publisher, self._trial):
            self.destroy_publisher(publisher)
        self._experiment = None
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take torque away for good."""
        if self._active:
            self._stop("the controller was shut down")
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Take torque away, should the node end while it is active."""
        if self._active and self.context.ok():
            self._stop("the controller was ended")
        super().destroy_node()

    def _prepare(self) -> Experiment:
        self._experiment = Experiment(self._settings, self._announce)
        # Readings of the two sensor topics that still wait for their partner, by stamp.
        self._positions: dict[int, tuple[float, ...]] = {}
        self._torques: dict[int, tuple[float, ...]] = {}
        # What the watchdog ramps down; stays zero if the experiment is over before it expires.
        self._last_command = self._experiment.command.copy()
        return self._experiment

    def _stop(self, reason: str) -> None:
        """Leave the plant with zero torque and the world with an explanation."""
        self._active = False
        self._timer.cancel()
        if self._experiment is not None and not self._experiment.finished:
            self._experiment.abort(reason)
            self._commands.publish(self._experiment.command)

    def _announce(self, status: TrialStatus) -> None:
        self._trial.publish(trial_status_message(status))

    def _on_position(self, stamp_ns: int, theta: tuple[float, ...]) -> None:
        tau_h = self._torques.pop(stamp_ns, None)
        if tau_h is None:
            self._positions[stamp_ns] = theta
        else:
            self._answer(stamp_ns, theta, tau_h)

    def _on_torque(self, stamp_ns: int, tau_h: tuple[float, ...]) -> None:
        theta = self._positions.pop(stamp_ns, None)
        if theta is None:
            self._torques[stamp_ns] = tau_h
        else:
            self._answer(stamp_ns, theta, tau_h)

    def _answer(self, stamp_ns: int, theta: tuple[float, ...], tau_h: tuple[float, ...]) -> None:
        experiment = self._experiment
        if not self._active or experiment is None:
            return
        # Older readings without a partner are lost samples, which the experiment counts.
        for waiting in (self._positions, self._torques):
            for old in [stamp for stamp in waiting if stamp < stamp_ns]:
                del waiting[old]
        self._watchdog.feed(time.monotonic())
        experiment.answer(stamp_ns, theta, tau_h)
        self._commands.publish(experiment.command)
        self._perturbation.publish(stamp_ns, experiment.tau_delta)

    def _on_malformed(self, error: ArmimpError) -> None:
        experiment = self._experiment
        if not self._active or experiment is None:
            return
        experiment.abort(f"malformed sensor message: {error}")
        self._commands.publish(experiment.command)

    def _on_watchdog(self) -> None:
        experiment, now = self._experiment, time.monotonic()
        if experiment is None or not self._watchdog.expired(now):
            return
        if not experiment.finished:
            self._last_command = experiment.command.copy()
            experiment.abort("no sensor sample arrived any more")
        allowance = self._watchdog.allowance(now)
        self._commands.publish(self._last_command * allowance)
        if allowance == 0.0:
            self._timer.cancel()


def main() -> int:
    """Run the controller node as a process."""
    return run_node(ImbicControllerNode)


if __name__ == "__main__":
    sys.exit(main())
