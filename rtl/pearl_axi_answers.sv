// SPDX-License-Identifier: MIT
// The answers of one channel, R or B, in the order in which they were asked for.
//
// A request takes a place, with a note that comes back beside the answer. The place is free again once
// the master has taken the answer, so there is always room for an answer, however long the master waits.
module pearl_axi_answers
  import pearl_pkg::*;
#(
    parameter int unsigned NOTE_BITS   = 4,
    parameter int unsigned ANSWER_BITS = 2
) (
    input  logic                   clk_i,
    input  logic                   rst_ni,
    // There is a place.
    output logic                   room_o,
    input  logic                   ask_i,
    input  logic [  NOTE_BITS-1:0] note_i,
    input  logic                   answer_i,
    input  logic [ANSWER_BITS-1:0] data_i,
    output logic                   valid_o,
    output logic [  NOTE_BITS-1:0] note_o,
    output logic [ANSWER_BITS-1:0] data_o,
    input  logic                   take_i
);

  // Enough for an answer a cycle: if it is taken at once, a place is free again PORT_LATENCY + 2 cycles after
  // its request.
  localparam int unsigned DEPTH = 2 ** $clog2(PORT_LATENCY + 2);
  localparam int unsigned PLACE_BITS = $clog2(DEPTH + 1);

  logic room_q, noted;
  logic [PLACE_BITS-1:0] places_d, places_q;

  assign places_d = places_q - PLACE_BITS'(ask_i) + PLACE_BITS'(take_i);

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      places_q <= PLACE_BITS'(DEPTH);
      room_q   <= 1'b1;
    end else begin
      places_q <= places_d;
      room_q   <= places_d != '0;
    end
  end

  assign room_o = room_q;

  pearl_fifo #(
      .WIDTH(NOTE_BITS),
      .DEPTH(DEPTH)
  ) u_notes (
      .clk_i,
      .rst_ni,
      .push_i (ask_i),
      .data_i (note_i),
      .valid_o(noted),
      .data_o (note_o),
      .pop_i  (take_i)
  );

  pearl_fifo #(
      .WIDTH(ANSWER_BITS),
      .DEPTH(DEPTH)
  ) u_answers (
      .clk_i,
      .rst_ni,
      .push_i (answer_i),
      .data_i (data_i),
      .valid_o(valid_o),
      .data_o (data_o),
      .pop_i  (take_i)
  );

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (noted || !valid_o)
      else $error("pearl_axi_answers: an answer came that nobody asked for");
    end
  end

endmodule
