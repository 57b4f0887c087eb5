// SPDX-License-Identifier: MIT
// A memory that the host fills with one stream of bits and the pipeline takes rows from, in order.
//
// Words flow through the memory's two registers and the unpacker to a queue of rows, each as soon as there
// is room behind it. Host and pipeline share the read port: the host is served only while busy_i is low.
module pearl_input_bank
  import pearl_pkg::*;
#(
    parameter int unsigned ROW_BITS = 48,
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned WORDS = 3,
    localparam int unsigned ADDR_BITS = index_bits(WORDS)
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                busy_i,
    // Starts over at the first word.
    input  logic                start_i,
    output logic                valid_o,
    output logic [ROW_BITS-1:0] row_o,
    input  logic                take_i,

    input  logic                 host_re_i,
    input  logic                 host_we_i,
    input  logic [ADDR_BITS-1:0] host_addr_i,
    input  logic [  DATA_WL-1:0] host_wdata_i,
    output logic [  DATA_WL-1:0] host_rdata_o
);

  // A word is in the memory's own register, and at its output.
  logic read_q, out_q, read_moves, out_moves;
  logic re, active_q, ended_q, word_ready, row_valid, row_ready;
  logic [$clog2(WORDS+1)-1:0] count_q;
  logic [ROW_BITS-1:0] row;

  assign out_moves = !out_q || word_ready;
  assign read_moves = !read_q || out_moves;
  assign re = active_q && read_moves;

  always_ff @(posedge clk_i) begin
    if (!rst_ni || start_i) begin
      active_q <= start_i && rst_ni;
      ended_q  <= 1'b0;
      read_q   <= 1'b0;
      out_q    <= 1'b0;
      count_q  <= '0;
    end else begin
      if (read_moves) read_q <= active_q;
      if (out_moves) out_q <= read_q;
      if (re) begin
        count_q  <= count_q + 1'b1;
        active_q <= 32'(count_q) != WORDS - 1;
      end
      ended_q <= !active_q && !read_q && (!out_q || word_ready);
    end
  end

  pearl_ram #(
      .WIDTH(DATA_WL),
      .DEPTH(WORDS)
  ) u_ram (
      .clk_i,
      .we_i   (host_we_i),
      .waddr_i(host_addr_i),
      .wdata_i(host_wdata_i),
      .re_i   (busy_i ? re : host_re_i),
      .raddr_i(busy_i ? count_q[ADDR_BITS-1:0] : host_addr_i),
      .oe_i   (!busy_i || out_moves),
      .rdata_o(host_rdata_o)
  );

  pearl_unpacker #(
      .ROW_BITS(ROW_BITS),
      .DATA_WL (DATA_WL)
  ) u_unpacker (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .valid_i(out_q),
      .ready_o(word_ready),
      .word_i (host_rdata_o),
      .end_i  (ended_q),
      .valid_o(row_valid),
      .ready_i(row_ready),
      .row_o  (row)
  );

  pearl_slice #(
      .WIDTH(ROW_BITS)
  ) u_rows (
      .clk_i,
      .rst_ni (rst_ni && !start_i),
      .valid_i(row_valid),
      .ready_o(row_ready),
      .data_i (row),
      .valid_o(valid_o),
      .ready_i(take_i),
      .data_o (row_o)
  );

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (valid_o || !take_i)
      else $error("pearl_input_bank: a row was taken that is not there");
    end
  end

endmodule
