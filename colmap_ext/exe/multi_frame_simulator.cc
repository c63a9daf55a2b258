// Command multi_frame_simulator.

#include <iostream>

#include "colmap_ext/exe/command.h"
#include "colmap_ext/host/log.h"
#include "colmap_ext/options/option_parser.h"
#include "colmap_ext/simulation/simulator.h"

namespace mfir {

int RunMultiFrameSimulator(int argc, char** argv) {
  return RunCommand([&]() {
    SimulatorOptions options;
    std::string output_path;
    OptionParser parser;
    parser.SetHelp(
        "Simulates a capture of a camera array with exact truth: images, "
        "frames, drifted calibration.",
        "colmap multi_frame_simulator --output_path CAPTURE "
        "--Simulator.num_cameras 16");
    parser.AddRequired("output_path", &output_path, "folder of the capture");
    parser.BeginGroup("Array, scene and errors");
    VisitSimulatorOptions(
        &options, [&](const char* name, auto* value, const char* help) {
          parser.Add(std::string("Simulator.") + name, value, help);
        });
    parser.Add("Simulator.num_threads", &options.num_threads, "-1: all");
    parser.Add("Simulator.overwrite",
               &options.overwrite,
               "1: replace an earlier simulated capture");
    parser.Add("Simulator.quiet", &options.quiet, "1: print nothing");
    parser.Parse(argc, argv);
    options.Check();
    CheckSimulatorOutput(options, output_path);

    if (!options.quiet) {
      host::PrintHeading1("Simulating " + std::to_string(options.num_frames) +
                          " frames of " + std::to_string(options.num_cameras) +
                          " cameras");
    }
    const SimulatedCapture capture = SimulateCapture(options);
    WriteSimulatedCapture(
        capture, output_path, [&parser](const std::string& folder) {
          parser.Write(folder + "/project.ini");
        });
    if (!options.quiet) {
      std::cout << "Capture written to " << output_path << std::endl;
    }
  });
}

}  // namespace mfir
