// SPDX-License-Identifier: MIT
// A register slice in a channel of valid and ready: no output depends on an input of the same cycle.
// It has two entries, so that a word can pass in every cycle all the same.
module pearl_slice #(
    parameter int unsigned WIDTH = 32
) (
    input  logic             clk_i,
    input  logic             rst_ni,
    input  logic             valid_i,
    output logic             ready_o,
    input  logic [WIDTH-1:0] data_i,
    output logic             valid_o,
    input  logic             ready_i,
    output logic [WIDTH-1:0] data_o
);

  // Not ready means that the spare entry is taken, or, without a valid one before it, that there was
  // a reset: what came during one would be lost.
  logic valid_q, ready_q, move;
  logic [WIDTH-1:0] data_q, spare_q;

  assign move = ready_i || !valid_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      valid_q <= 1'b0;
      ready_q <= 1'b0;
    end else begin
      if (move && ready_q) valid_q <= valid_i;
      ready_q <= move || (ready_q && !valid_i);
    end
  end

  always_ff @(posedge clk_i) begin
    if (ready_q) spare_q <= data_i;
    if (move) data_q <= ready_q ? data_i : spare_q;
  end

  assign ready_o = ready_q;
  assign valid_o = valid_q;
  assign data_o  = data_q;

endmodule
