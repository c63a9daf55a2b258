// ONNX files of small networks, as bytes of the protocol buffer format
// (onnx.proto names the fields whose numbers are used here).

#pragma once

#include <cstring>
#include <string>
#include <vector>

namespace mfir {

class ProtoMessage {
 public:
  ProtoMessage& Integer(int field, uint64_t value) {
    Varint(field << 3);
    Varint(value);
    return *this;
  }
  ProtoMessage& Bytes(int field, const std::string& bytes) {
    Varint(field << 3 | 2);
    Varint(bytes.size());
    bytes_ += bytes;
    return *this;
  }
  ProtoMessage& Message(int field, const ProtoMessage& message) {
    return Bytes(field, message.bytes_);
  }
  const std::string& Str() const { return bytes_; }

 private:
  void Varint(uint64_t value) {
    for (; value >= 128; value >>= 7) {
      bytes_ += static_cast<char>((value & 127) | 128);
    }
    bytes_ += static_cast<char>(value);
  }

  std::string bytes_;
};

// A network in the making: input 1 x channels x size x size, any if 0.
class OnnxBuilder {
 public:
  explicit OnnxBuilder(int num_channels, int size = 0) : size_(size) {
    AddValue(11, "image", num_channels);
  }

  // weights: output channel, input channel, row, column.
  void Conv(const std::string& input,
            const std::string& output,
            int num_inputs,
            int num_outputs,
            int kernel,
            int stride,
            int padding,
            const std::vector<float>& weights) {
    const std::string weights_name = output + "_weights";
    ProtoMessage tensor;
    for (const int size : {num_outputs, num_inputs, kernel, kernel}) {
      tensor.Integer(1, size);
    }
    std::string raw(weights.size() * sizeof(float), '\0');
    std::memcpy(&raw[0], weights.data(), raw.size());
    tensor.Integer(2, 1).Bytes(8, weights_name).Bytes(9, raw);
    graph_.Message(5, tensor);
    ProtoMessage node;
    node.Bytes(1, input).Bytes(1, weights_name).Bytes(2, output);
    node.Bytes(3, output + "_node").Bytes(4, "Conv");
    AddInts("kernel_shape", {kernel, kernel}, &node);
    AddInts("strides", {stride, stride}, &node);
    AddInts("pads", {padding, padding, padding, padding}, &node);
    graph_.Message(1, node);
  }

  void Output(const std::string& name, int num_channels) {
    AddValue(12, name, num_channels);
  }

  // The file.
  std::string Str() const {
    ProtoMessage graph = graph_;
    graph.Bytes(2, "test");
    return ProtoMessage()
        .Integer(1, 7)
        .Message(8, ProtoMessage().Bytes(1, "").Integer(2, 12))
        .Message(7, graph)
        .Str();
  }

 private:
  static void AddInts(const std::string& name,
                      const std::vector<int>& values,
                      ProtoMessage* node) {
    ProtoMessage attribute;
    attribute.Bytes(1, name).Integer(20, 7);
    for (const int value : values) attribute.Integer(8, value);
    node->Message(5, attribute);
  }

  void AddValue(int field, const std::string& name, int num_channels) {
    ProtoMessage shape;
    shape.Message(1, ProtoMessage().Integer(1, 1));
    shape.Message(1, ProtoMessage().Integer(1, num_channels));
    for (const char* name_of_size : {"height", "width"}) {
      shape.Message(1,
                    size_ > 0 ? ProtoMessage().Integer(1, size_)
                              : ProtoMessage().Bytes(2, name_of_size));
    }
    const ProtoMessage tensor_type =
        ProtoMessage().Integer(1, 1).Message(2, shape);
    graph_.Message(field,
                   ProtoMessage().Bytes(1, name).Message(
                       2, ProtoMessage().Message(1, tensor_type)));
  }

  const int size_;
  ProtoMessage graph_;
};

}  // namespace mfir
