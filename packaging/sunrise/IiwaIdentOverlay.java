// NOT COMPILED AND NOT RUN BY THIS PROJECT. KUKA's libraries are not public, so nobody could compile this file where it
// was written, and it has never run on a cabinet. Compile it in your own Sunrise.Workbench, read it line by line, and run
// it in T1 first, with the enabling switch and the emergency stop in your hand.
//
// For Sunrise.OS 1.x with the option Sunrise.FRI 1.x (FRI 1.11 to 1.16), in the Java of that Workbench (no lambdas).
// README.md beside this file says how to install it and what changes for Sunrise.OS 2.x.
//
// Every name of KUKA's API that stands here was taken from published applications:
//   [1] github.com/epfl-lasa/iiwa_ros, iiwa_driver/java/FRIOverlay.java: FRIConfiguration, FRISession.await,
//       FRIJointOverlay(session, ClientCommandMode), PositionHold, addMotionOverlay, displayModalDialog
//   [2] github.com/RobotLocomotion/drake-iiwa-driver, kuka-driver/sunrise_1.14/DrakeFRIPositionDriver.java:
//       setPortOnRemote, PositionControlMode, CommandInvalidException when the overlay ends
//   [3] github.com/kroshu/kuka_drivers, kuka_sunrise_fri_driver/robot_application/src/ros2/modules/FRIManager.java:
//       IllegalStateException of FRISession.close; its issue 33: about 5 s before the next session
//   [4] github.com/moveit/moveit_experimental, sunrise_os/AcmeFRI/src/application/HandGuideFromCurrPos.java:
//       createFromTemplate, attachTo, super.dispose
//   [5] KUKA's sample com.kuka.roboticsAPI.directServo.samples.DirectServoSampleSimpleJointMotion, in public copies:
//       LBR.getOperationMode, OperationMode.T1
//   [6] github.com/lbr-stack/lbr_fri_ros2_stack: UDP ports 30200 to 30209
// Not certain, because no public page of KUKA says it:
//   (a) that getLoadData().getMass() of a tool template is in kg; public applications print it, none states the unit;
//   (b) that a tool counts in the external torque as soon as attachTo was called; `iiwa-ident doctor` shows the effect;
//   (c) which exception, if any, move() throws when the client ends. CommandInvalidException is what [2] catches.
//   (d) in which versions LBR has getOperationMode: [5] is old, newer public applications ask
//       lbr.getSafetyState().getOperationMode(); take that one if the first does not compile.
package application;

import java.util.concurrent.TimeUnit;
import java.util.concurrent.TimeoutException;

import com.kuka.connectivity.fastRobotInterface.ClientCommandMode;
import com.kuka.connectivity.fastRobotInterface.FRIConfiguration;
import com.kuka.connectivity.fastRobotInterface.FRIJointOverlay;
import com.kuka.connectivity.fastRobotInterface.FRISession;
import com.kuka.roboticsAPI.applicationModel.RoboticsAPIApplication;
import com.kuka.roboticsAPI.controllerModel.Controller;
import com.kuka.roboticsAPI.deviceModel.LBR;
import com.kuka.roboticsAPI.deviceModel.OperationMode;
import com.kuka.roboticsAPI.executionModel.CommandInvalidException;
import com.kuka.roboticsAPI.geometricModel.Tool;
import com.kuka.roboticsAPI.motionModel.PositionHold;
import com.kuka.roboticsAPI.motionModel.controlModeModel.PositionControlMode;
import com.kuka.roboticsAPI.uiModel.ApplicationDialogType;

/**
 * Holds the arm where it stands and lets `iiwa-ident run` overlay joint positions over FRI at 1 kHz. It plans no motion.
 */
public class IiwaIdentOverlay extends RoboticsAPIApplication {

    /** Address of the PC that runs iiwa-ident, on the robot's FRI network: `run --bind ADDRESS:PORT`. */
    private static final String CLIENT_ADDRESS = "192.170.10.1";

    /** UDP port of that PC, 30200 to 30209. */
    private static final int CLIENT_PORT = 30200;

    /** Period of the cabinet's messages in ms, each answered by one command. The recordings expect 1. */
    private static final int SEND_PERIOD_MS = 1;
    private static final int RECEIVE_MULTIPLIER = 1;

    /** How long the application waits for iiwa-ident, in seconds. */
    private static final int CLIENT_TIMEOUT_S = 300;

    /**
     * Tool template of this Sunrise project whose load data (mass, centre of mass, inertia) are those of what the flange
     * carries. null: the flange is empty. Give `iiwa-ident run` the same numbers with `--tool`.
     */
    private static final String TOOL_TEMPLATE = null;

    private LBR lbr;
    private Tool tool;
    private FRISession session;

    @Override
    public void initialize() {
        final Controller controller = (Controller) getContext().getControllers().toArray()[0];
        lbr = (LBR) controller.getDevices().toArray()[0];
        if (TOOL_TEMPLATE != null) {
            tool = createFromTemplate(TOOL_TEMPLATE);
            tool.attachTo(lbr.getFlange());
        }
    }

    @Override
    public void run() {
        if (!operatorAgrees()) {
            getLogger().info("Cancelled by the operator; nothing moved.");
            return;
        }

        final FRIConfiguration configuration = FRIConfiguration.createRemoteConfiguration(lbr, CLIENT_ADDRESS);
        configuration.setPortOnRemote(CLIENT_PORT);
        configuration.setSendPeriodMilliSec(SEND_PERIOD_MS);
        configuration.setReceiveMultiplier(RECEIVE_MULTIPLIER);
        session = new FRISession(configuration);
        getLogger().info("FRI is open to " + CLIENT_ADDRESS + ":" + CLIENT_PORT + ". Start `iiwa-ident run` there now.");

        try {
            // Returns when the connection is good enough for commands; that needs a client that answers.
            session.await(CLIENT_TIMEOUT_S, TimeUnit.SECONDS);
            getLogger().info("The connection is good. The arm follows iiwa-ident from now on.");

            // No dialogue from here on: iiwa-ident waits 60 s for the commanding states.
            final FRIJointOverlay overlay = new FRIJointOverlay(session, ClientCommandMode.POSITION);
            final PositionHold hold = new PositionHold(new PositionControlMode(), -1, TimeUnit.SECONDS);
            lbr.move(hold.addMotionOverlay(overlay));
            getLogger().info("The overlay has ended.");
        } catch (final TimeoutException e) {
            getLogger().error("No good connection within " + CLIENT_TIMEOUT_S + " s, nothing moved: "
                    + e.getLocalizedMessage());
        } catch (final CommandInvalidException e) {
            // The planned end too: with the arm at rest iiwa-ident stops answering, and the cabinet drops the overlay.
            getLogger().info("The overlay was ended by the cabinet: " + e.getLocalizedMessage());
        } finally {
            closeSession();
        }
    }

    /** Says what is about to happen, in which mode and with which load, and asks. */
    private boolean operatorAgrees() {
        final boolean t1 = lbr.getOperationMode() == OperationMode.T1;
        final String mode = t1
                ? "Mode T1: begin with `iiwa-ident run --amplitude 0.1`; a faster motion ends in a stop of the cabinet."
                : "NOT in T1. Go on only if this motion has run in T1 with a smaller amplitude before.";
        final String load = tool == null
                ? "Load data: none, the flange must be empty."
                : "Load data: " + TOOL_TEMPLATE + ", mass " + tool.getLoadData().getMass() + ". Is this tool mounted?";
        final int answer = getApplicationUI().displayModalDialog(
                ApplicationDialogType.QUESTION,
                "The arm will move on the commands of " + CLIENT_ADDRESS + ".\n" + mode + "\n" + load
                        + "\nIs the workspace free of people?",
                "Go on", "Cancel");
        return answer == 0;
    }

    private void closeSession() {
        if (session == null) {
            return;
        }
        try {
            session.close();
            getLogger().info("FRI is closed. Wait about 5 s before the next start.");
        } catch (final IllegalStateException e) {
            getLogger().warn("FRI was closed already: " + e.getLocalizedMessage());
        }
        session = null;
    }

    /** Also when the application is ended from the smartPAD. */
    @Override
    public void dispose() {
        closeSession();
        super.dispose();
    }

    public static void main(final String[] args) {
        final IiwaIdentOverlay application = new IiwaIdentOverlay();
        application.runApplication();
    }
}
